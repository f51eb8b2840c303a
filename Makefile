# Two commands matter: `make demo` and `make test`. Everything is installed into .venv. Of the rest of the machine change only
# Debian packages that a step needs (firmware, browser and database tests; that step says so), pip's own cache, and the
# simulator's textures in ~/.cache/sentinel (some 150 MB for each flat, at most 3 GB, the oldest go first; `make clean-cache` removes them).
SHELL := /bin/bash
VENV := .venv
BIN := $(VENV)/bin
SEED ?= 1
PORT ?= 8080
MINUTES ?= 10

.PHONY: help demo setup test lint audit check firmware bench bench-stop bench-slam bench-page bench-network results soak clean clean-cache

help:
	@echo "make demo            simulated robot + station + page at http://127.0.0.1:8080 (ONCE=1: end by itself, SEED=n: another flat, PORT=n)"
	@echo "make test            everything that needs no hardware: lint, types, tests"
	@echo "make setup           only install, into .venv"
	@echo "make lint | audit | firmware | bench (QUICK=1: a try) | bench-stop (SCALE=0.1) | bench-slam | bench-page | bench-network (root) | soak (MINUTES=10) | clean | clean-cache"
	@echo "make results         measure what docs/results.md lacks of the present code, for hours; goes on where it was ended"
	@echo "                     (ONLY=\"clock fuzz\": these alone, QUICK=1: a try, RENDER=1: only make the page anew)"

WEB_SOURCES := $(shell find station/web -path '*/node_modules' -prune -o -path '*/dist' -prune -o -path '*/__pycache__' -prune -o -type f -print 2>/dev/null)

$(VENV)/.run: pyproject.toml constraints.txt $(WEB_SOURCES)
	@scripts/setup.sh run

$(VENV)/.dev: pyproject.toml constraints.txt $(WEB_SOURCES)
	@scripts/setup.sh dev

setup: $(VENV)/.run

demo: $(VENV)/.run
	@$(BIN)/station demo $(if $(ONCE),--once) --seed $(SEED) --port $(PORT)

lint: $(VENV)/.dev
	@scripts/lint.sh

audit: $(VENV)/.dev
	@ADVISORIES=$(ADVISORIES) scripts/audit.sh

test:
	@scripts/test.sh

firmware:
	@firmware/install-deps.sh
	@$(MAKE) -C firmware

bench: $(VENV)/.dev
	@firmware/install-deps.sh
	@scripts/open3d-need.sh
	@$(BIN)/python -m benchmarks.run_suite $(if $(QUICK),--quick) $(if $(ONLY),--only $(ONLY))

results: $(VENV)/.dev
ifdef RENDER
	@$(BIN)/python -m benchmarks.results_page
else
	@firmware/install-deps.sh
	@scripts/open3d-need.sh
	@$(BIN)/python -m benchmarks.run_suite --publish $(if $(QUICK),--quick) $(if $(ONLY),--only $(ONLY))
endif

bench-stop: $(VENV)/.dev
	@$(BIN)/python -m benchmarks.bench_stop $(if $(SCALE),--scale $(SCALE))

bench-slam: $(VENV)/.dev
	@$(BIN)/python -m benchmarks.slam_studies speed

bench-page: $(VENV)/.dev
	@$(BIN)/python -m benchmarks.bench_page

bench-network: $(VENV)/.dev
	@$(BIN)/python -m benchmarks.bench_network

soak: $(VENV)/.dev
	@$(BIN)/python -m benchmarks.bench_link --minutes $(MINUTES)
	@$(BIN)/python -m benchmarks.bench_disconnects --disconnects 0 --minutes $(MINUTES)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis demo station/web/node_modules station/web/dist

clean-cache:
	rm -rf "$${XDG_CACHE_HOME:-$$HOME/.cache}/sentinel"
