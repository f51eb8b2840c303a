"""Runs the benchmarks of `suite.py` one after the other: `make bench` and `make results`.

    python -m benchmarks.run_suite                    results in benchmarks/results/
    python -m benchmarks.run_suite --publish          results in docs/results/, and docs/results.md made of them anew
    python -m benchmarks.run_suite --only clock fuzz  these alone
    python -m benchmarks.run_suite --quick            with so little data that it only shows that they work

What each prints lands in benchmarks/results/NAME.txt. `--publish` leaves out what was measured with the present code
and these arguments already, so it goes on where it was ended, and asks for committed code: a published figure must be
that of a commit. A quick run publishes nothing: its results, and a page of them, are in benchmarks/results/quick/.
Exit code 0 when all ended well.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

from benchmarks import results_page
from benchmarks.result import FOLDER, ROOT, CodeState, command_line, load
from benchmarks.suite import SUITE, Benchmark


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--publish", action="store_true")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=[b.name for b in SUITE])
    options = parser.parse_args()
    chosen = [b for b in SUITE if b.name in options.only] if options.only else list(SUITE)
    state = CodeState.of_now()
    publishes = options.publish and not options.quick
    if publishes and not state.clean:
        print("run_suite: commit the code first: a published figure must be that of a commit", file=sys.stderr)
        return 1
    out = FOLDER / "quick" if options.quick else FOLDER
    out.mkdir(parents=True, exist_ok=True)
    folder = results_page.PUBLISHED if publishes else out
    failed = []
    for benchmark in chosen:
        results = folder / f"{benchmark.name}.json"
        if reason := why_not(benchmark, options, results, state):
            print(f"== left out: {benchmark.name}: {reason}", flush=True)
        elif run(benchmark, options, results, out / f"{benchmark.name}.txt") != 0:
            print(f"run_suite: {benchmark.name} failed", file=sys.stderr, flush=True)
            failed.append(benchmark.name)
        if publishes:
            results_page.write()
    if options.quick:
        results_page.write(out, out / "results.md", needs_clean=False)
    if failed:
        print(f"run_suite: failed: {' '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def why_not(benchmark: Benchmark, options: argparse.Namespace, results: Path, state: CodeState) -> str:
    """Why it is left out; "" when it is to be run."""
    if benchmark.has_own_target and not options.publish and not options.only:
        return "it has a target of its own"
    if options.quick and benchmark.quick is None:
        return "it cannot be made short"
    if benchmark.data and not (ROOT / benchmark.data).exists():
        return f"{benchmark.data} is not there"
    if options.publish and not options.quick and is_done(benchmark, results, state):
        return "measured with this code already"
    return ""


def is_done(benchmark: Benchmark, results: Path, state: CodeState) -> bool:
    """Whether that file is of the present code and these arguments."""
    if not results.exists():
        return False
    kept = load(results)
    command = command_line(f"benchmarks.{benchmark.module}", shlex.split(benchmark.full))
    return kept.clean and kept.code == state.code and kept.command == command


def run(benchmark: Benchmark, options: argparse.Namespace, results: Path, printed: Path) -> int:
    """Its exit code; what it prints goes to the screen and to a file."""
    arguments = (benchmark.quick if options.quick else benchmark.full) or ""
    command = [sys.executable, "-m", f"benchmarks.{benchmark.module}", *shlex.split(arguments)]
    print(f"== {benchmark.name}: {shlex.join(command[1:])}", flush=True)
    with (
        printed.open("w") as file,
        subprocess.Popen([*command, "--results", str(results)], cwd=ROOT, stdout=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
            file.write(line)
    return process.returncode


if __name__ == "__main__":
    sys.exit(main())
