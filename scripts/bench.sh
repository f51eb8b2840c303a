#!/usr/bin/env bash
# Every benchmark that has no target of its own, one after the other; what each prints lands in benchmarks/results/NAME.txt.
# QUICK=1: the same with so little data that it only shows that they work. Exit code 0 when all ended well.
set -uo pipefail
cd "$(dirname "$0")/.."
python=${BENCH_PYTHON:-.venv/bin/python}
results=${BENCH_RESULTS:-benchmarks/results}
quick=${QUICK:-}
failed=()
named=" benchmarks.bench_stop benchmarks.bench_page "
mkdir -p "$results/drives"

# bench NAME MODULE ARGUMENTS...
bench() {
  local name=$1 module=$2
  shift 2
  named+="$module "
  echo "== $module $*"
  "$python" -m "$module" "$@" | tee "$results/$name.txt"
  [ "${PIPESTATUS[0]}" = 0 ] || { echo "bench: $name failed" >&2; failed+=("$name"); }
}

# pick FULL -- QUICK: the words of the mode asked for
pick() {
  local full=()
  while [ "$1" != -- ]; do full+=("$1"); shift; done
  shift
  if [ -n "$quick" ]; then picked=("$@"); else picked=("${full[@]}"); fi
}

drive=$results/drives/${quick:+quick-}small1
if [ ! -e "$drive" ]; then
  pick -- --max-duration 12 --fps 15
  bench drive robot.simulation.cli dataset --world small --seed 1 --route mapping --out "$drive" "${picked[@]}"
fi

pick --runs 1000 -- --runs 20;                                 bench clock benchmarks.bench_clock "${picked[@]}"
pick --inputs 1000000 -- --inputs 2000;                        bench fuzz benchmarks.bench_fuzz "${picked[@]}"
pick --kills 600 -- --kills 6;                                 bench crash benchmarks.bench_crash --out "$results/${quick:+quick-}crash.jsonl" "${picked[@]}"
pick --flips 1000 -- --flips 10;                               bench flips benchmarks.bench_flips "${picked[@]}"
pick --examples 100 -- --examples 2;                           bench openapi benchmarks.bench_openapi "${picked[@]}"
pick --minutes 2 -- --minutes 0.1 --stall-minutes 0.2;         bench link benchmarks.bench_link "${picked[@]}"
pick --minutes 10 -- --minutes 0.5 --robots 2;                 bench fleet benchmarks.bench_fleet "${picked[@]}"
pick --seconds 20 -- --seconds 2;                              bench robot_cpu benchmarks.bench_robot_cpu "${picked[@]}"
pick --trials 100 -- --trials 2 --plain-minutes 0.5;           bench hijack benchmarks.bench_hijack "${picked[@]}"
pick --frames 200 -- --frames 5;                               bench renderer benchmarks.bench_renderer "${picked[@]}"
pick --seeds 10 -- --seeds 1 --pairs 2;                        bench simulated_views benchmarks.bench_simulated_views "${picked[@]}"
pick --pairs 200 -- --pairs 1 --set known;                     bench registration benchmarks.bench_registration "${picked[@]}"
pick --seeds 30 -- --seeds 1;                                  bench places benchmarks.places "${picked[@]}" --out "$results/places.json"
pick --runs 50 -- --runs 1 --duration 3;                       bench slam_consistency benchmarks.bench_slam consistency "${picked[@]}"
bench slam_drive benchmarks.bench_slam datasets "$drive"
bench sfm_drive benchmarks.bench_sfm "$drive"
pick --flats 3 --drives 5 -- --flats 1 --drives 1;             bench current_place benchmarks.bench_current_place "${picked[@]}"
if [ -z "$quick" ]; then
  bench slam_wheels benchmarks.bench_slam wheels "$drive"
  bench mapping benchmarks.bench_mapping --backend sfm --backend ukf --scratch "$results/drives"
  bench robot_wheels benchmarks.check_robot_wheels
fi
# One that nobody named here yet runs as it is; a quick run cannot know how to make it short.
for script in benchmarks/bench_*.py; do
  name=$(basename "$script" .py)
  [[ $named == *" benchmarks.$name "* ]] && continue
  if [ -z "$quick" ]; then bench "${name#bench_}" "benchmarks.$name"; else echo "== left out of the quick run: $name"; fi
done
[ ${#failed[@]} -eq 0 ] || { echo "bench: failed: ${failed[*]}" >&2; exit 1; }
