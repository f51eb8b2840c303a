#!/usr/bin/env bash
# What `make test` and CI run: formatting, lint, types, then every test that needs no hardware.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=.venv/bin
scripts/apt-need.sh "browser tests" chromium fonts-dejavu-core
scripts/apt-need.sh "database tests" postgresql
scripts/open3d-need.sh
[ -x firmware/install-deps.sh ] && firmware/install-deps.sh
$bin/ruff format --check --quiet .
$bin/ruff check --quiet .
$bin/bandit -q -c pyproject.toml -r robot station shared
$bin/mypy
$bin/lint-imports --no-cache
# Exit code 2: no Node, or npm reaches no registry. Whoever knows that sets NO_NODE=1; else the page would go unchecked.
checked=0
$bin/python station/web/build_hook.py --check || checked=$?
if [ $checked -eq 2 ] && [ -z "${NO_NODE:-}" ]; then echo "Where there is no Node, set NO_NODE=1" >&2; fi
if [ $checked -ne 0 ] && ! { [ $checked -eq 2 ] && [ -n "${NO_NODE:-}" ]; }; then exit $checked; fi
exec $bin/pytest -m "not hardware" "$@"
