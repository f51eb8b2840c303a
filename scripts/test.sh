#!/usr/bin/env bash
# What `make test` and CI run: formatting, lint, types, then every test that needs no hardware.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=.venv/bin
debian_packages() {
  scripts/apt-need.sh "browser tests" chromium fonts-dejavu-core
  scripts/apt-need.sh "database tests" postgresql
  [ ! -x firmware/install-deps.sh ] || firmware/install-deps.sh
  # pip leaves a core idle meanwhile. What cannot be built here the tests say, or are skipped.
  nice make --silent -C firmware emulator build/pc/test_core build/pc/fuzz_core >/dev/null 2>&1 || true
}
# Debian's packages are unpacked while Python's are fetched, and lint computes as soon as those are there. The environment
# comes first and Open3D last: either may ask for a Debian package of its own, and one apt-get does not wait for another.
scripts/setup.sh env
debian_packages &
debian=$!
make --silent .venv/.dev
install_missing() {
  wait $debian
  scripts/open3d-need.sh
}

# Several processes share few cores: a second thread of linear algebra in each of them spins for a core that it does not
# get, which doubled the CPU time of structure from motion; OpenCV's take a third more for SIFT. And sources are compiled
# once, not by every program anew.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OPENCV_FOR_THREADS_NUM=1
unset PYTHONDONTWRITEBYTECODE
# As a module: of a program that is a file, every process that multiprocessing starts runs the file's imports again.
pytest=($bin/python -m pytest)
if [ $# -gt 0 ]; then
  install_missing
  scripts/lint.sh
  exec "${pytest[@]}" -m "not hardware" "$@"
fi

# Five processes side by side, so that one computes while others wait. Whole robots go by the clock, and are judged by
# how often they know their place in time: all else gives way to them, and what only computes to all. Browsers come after
# them. Sockets are most of the tests and mostly wait: two halves. Two processes compute, one after lint: each takes the
# next file that the other has not begun, folders of long ones first, so that neither core is left alone for long at the end.
# What those in the background say comes when the one that is seen has ended.
run=("${pytest[@]}" --durations=15)
by_the_clock="not hardware and not computing"
said=$(mktemp -d)
pids=()
trap 'kill "${pids[@]}" 2>/dev/null || true; rm -rf "$said"' EXIT
beside() {
  "$@" -p no:cacheprovider >"$said/${#pids[@]}" 2>&1 &
  pids+=($!)
}
robots_then_browsers() {
  local failed=0
  "$@" -m "$by_the_clock and slow" tests/integration tests/e2e || failed=$?
  "$@" -m "$by_the_clock and not slow" tests/e2e || failed=$?
  return $failed
}
compute() {
  exec nice -n 19 "${run[@]}" -m "not hardware and computing" --share "$said/begun" \
    tests/golden tests/integration tests/e2e tests/property tests/unit "$@"
}
lint_then_compute() {
  nice -n 19 scripts/lint.sh
  until [ -e "$said/installed" ]; do sleep 1; done
  compute "$@"
}
# Lint needs nothing that is installed here, and computes while that is fetched. What checks the page, which it may install
# for itself, is among the last that the tests ask for.
mkdir "$said/begun"
beside lint_then_compute
install_missing
touch "$said/installed"
beside robots_then_browsers "${run[@]}"
beside compute
beside nice "${run[@]}" -m "$by_the_clock and not slow" tests/integration/test_[a-k]*.py
failed=0
nice "${run[@]}" -m "$by_the_clock and not slow" tests/integration/test_[!a-k]*.py || failed=$?
for i in "${!pids[@]}"; do
  wait "${pids[i]}" || failed=$?
  cat "$said/$i"
done
exit $failed
