# Two commands matter: `make demo` and `make test`. Everything is installed into .venv. Of the rest of the machine change only
# Debian packages that a step needs (firmware, browser and database tests; that step says so), pip's own cache, and the
# simulator's textures in ~/.cache/sentinel (some 150 MB for each flat, at most 3 GB, the oldest go first; `make clean-cache` removes them).
SHELL := /bin/bash
VENV := .venv
BIN := $(VENV)/bin
SEED ?= 1
PORT ?= 8080
MINUTES ?= 10

.PHONY: help demo setup test lint audit check firmware bench bench-stop bench-slam bench-page soak clean clean-cache

help:
	@echo "make demo            simulated robot + station + page at http://127.0.0.1:8080 (ONCE=1: end by itself, SEED=n: another flat, PORT=n)"
	@echo "make test            everything that needs no hardware: lint, types, tests"
	@echo "make setup           only install, into .venv"
	@echo "make lint | audit | firmware | bench (QUICK=1: a try) | bench-stop | bench-slam | bench-page | soak (MINUTES=10) | clean | clean-cache"

WEB_SOURCES := $(shell find station/web -path '*/node_modules' -prune -o -path '*/dist' -prune -o -path '*/__pycache__' -prune -o -type f -print 2>/dev/null)

$(VENV)/.run: pyproject.toml constraints.txt $(WEB_SOURCES)
	@scripts/setup.sh run

$(VENV)/.dev: pyproject.toml constraints.txt $(WEB_SOURCES)
	@scripts/setup.sh dev

setup: $(VENV)/.run

demo: $(VENV)/.run
	@$(BIN)/station demo $(if $(ONCE),--once) --seed $(SEED) --port $(PORT)

lint: $(VENV)/.dev
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/bandit -q -c pyproject.toml -r robot station shared
	@$(BIN)/mypy
	@$(BIN)/python station/web/build_hook.py --check

audit: $(VENV)/.dev
	@ADVISORIES=$(ADVISORIES) scripts/audit.sh

test: $(VENV)/.dev
	@scripts/test.sh

firmware:
	@firmware/install-deps.sh
	@$(MAKE) -C firmware

bench: $(VENV)/.dev
	@firmware/install-deps.sh
	@QUICK=$(QUICK) scripts/bench.sh

bench-stop: $(VENV)/.dev
	@$(BIN)/python benchmarks/bench_stop.py

bench-slam: $(VENV)/.dev
	@$(BIN)/python -m benchmarks.slam_studies speed

bench-page: $(VENV)/.dev
	@$(BIN)/python benchmarks/bench_page.py

soak: $(VENV)/.dev
	@$(BIN)/python benchmarks/bench_link.py --minutes $(MINUTES)
	@$(BIN)/python -m benchmarks.bench_disconnects --disconnects 0 --minutes $(MINUTES)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis demo station/web/node_modules station/web/dist

clean-cache:
	rm -rf "$${XDG_CACHE_HOME:-$$HOME/.cache}/sentinel"
