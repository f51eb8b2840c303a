#!/usr/bin/env bash
# What `make test` and CI run: formatting, lint, types, then every test that needs no hardware.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=.venv/bin
scripts/apt-need.sh "browser tests" chromium fonts-dejavu-core
scripts/apt-need.sh "database tests" postgresql
[ -x firmware/install-deps.sh ] && firmware/install-deps.sh
$bin/ruff format --check --quiet .
$bin/ruff check --quiet .
$bin/bandit -q -c pyproject.toml -r robot station shared
$bin/mypy
$bin/lint-imports --no-cache
$bin/python station/web/build_hook.py --check || [ $? -eq 2 ] # no Node, or no registry within reach: it says so
exec $bin/pytest -m "not hardware" "$@"
