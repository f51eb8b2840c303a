#!/usr/bin/env bash
# What `make test` and CI run: formatting, lint, types, then every test that needs no hardware.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=.venv/bin
scripts/apt-need.sh "browser tests" chromium fonts-dejavu-core
scripts/apt-need.sh "database tests" postgresql
scripts/open3d-need.sh
[ -x firmware/install-deps.sh ] && firmware/install-deps.sh
# Several processes share few cores: a second thread of linear algebra in each of them spins for a core that it does not
# get, which doubled the CPU time of structure from motion. And sources are compiled once, not by every program anew.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
unset PYTHONDONTWRITEBYTECODE
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
if [ $# -gt 0 ]; then exec $bin/pytest -m "not hardware" "$@"; fi
# Tests that only compute take the time in which those with sockets, programs and browsers wait; what they say comes last.
# The whole system of tests/e2e runs at the end, when it has the machine for itself.
computing=$(mktemp)
nice $bin/pytest -m "not hardware and computing" -p no:cacheprovider --durations=15 tests >"$computing" 2>&1 &
beside=$!
trap 'kill $beside 2>/dev/null || true; rm -f "$computing"' EXIT
failed=0
$bin/pytest -m "not hardware and not computing" --durations=15 tests/integration tests/e2e || failed=$?
wait $beside || failed=$?
cat "$computing"
exit $failed
