"""Throws damaged input at everything that reads a line: firmware parser (sanitizers on), serial reader, TCP decoder.

    python -m benchmarks.bench_fuzz [--inputs 1000000] [--seed 1]

No crash, no hang, no growing memory, no motion.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
import traceback
from typing import Any

from benchmarks.result import Figure, Run, add_results_option, share
from tests.support.fuzzing import fuzz_serial_reader, fuzz_tcp_decoder
from tests.support.paths import ROOT


def fuzz_firmware(inputs: int, seed: int) -> dict[str, Any]:
    """firmware/core on this PC under address and undefined-behaviour sanitizers."""
    firmware = ROOT / "firmware"
    subprocess.run(["make", "-s", "-C", str(firmware), "build/pc/fuzz_core"], check=True, capture_output=True)
    run = subprocess.run(
        [firmware / "build" / "pc" / "fuzz_core", str(inputs), str(seed)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr
    return {"inputs": inputs, "says": run.stdout.strip()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    add_results_option(parser, "fuzz")
    options = parser.parse_args()
    this_run = Run.begin()
    figures: list[Figure] = []
    for name, run in (
        ("firmware parser", fuzz_firmware),
        ("serial reader", fuzz_serial_reader),
        ("TCP decoder", fuzz_tcp_decoder),
    ):
        before_kb, start_s = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
        try:
            result, survived = run(options.inputs, options.seed), options.inputs
        except Exception:
            traceback.print_exc()
            result, survived = {}, 0
        grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb
        result |= {"seconds": round(time.monotonic() - start_s, 1), "memory_grown_kb": grown_kb}
        print(f"{name}: {result}", flush=True)
        what = f"{name}: damaged inputs without crash, hang or motion"
        figures.append(share(what, survived, options.inputs, at_least=100))
    this_run.write(options.results, figures)
    return 0 if all(figure.is_met for figure in figures) else 1


if __name__ == "__main__":
    sys.exit(main())
