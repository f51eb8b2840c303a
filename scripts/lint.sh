#!/usr/bin/env bash
# What `make lint` runs, and `make test` beside the tests: format, lint, types, imports, and the page's sources.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=.venv/bin
$bin/ruff format --check --quiet .
$bin/ruff check --quiet .
$bin/bandit -q -c pyproject.toml -r robot station shared
$bin/mypy
$bin/lint-imports --no-cache
# Exit code 2: no Node, or npm reaches no registry. Whoever knows that sets NO_NODE=1; else the page would go unchecked.
checked=0
$bin/python station/web/build_hook.py --check || checked=$?
if [ $checked -eq 2 ] && [ -z "${NO_NODE:-}" ]; then echo "Where there is no Node, set NO_NODE=1" >&2; fi
if [ $checked -eq 2 ] && [ -n "${NO_NODE:-}" ]; then exit 0; fi
exit $checked
