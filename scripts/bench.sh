#!/usr/bin/env bash
# Every benchmark, one after the other; results land in benchmarks/results/.
set -uo pipefail
cd "$(dirname "$0")/.."
failed=0
for script in benchmarks/bench_*.py; do
  echo "== $script"
  .venv/bin/python "$script" || { echo "bench: $script failed" >&2; failed=1; }
done
exit $failed
