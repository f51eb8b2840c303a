"""Throws damaged input at everything that reads a line: firmware parser (sanitizers on), serial reader, TCP decoder.

    python -m benchmarks.bench_fuzz [--inputs 1000000] [--seed 1]

No crash, no hang, no growing memory, no motion. Result on stdout and in benchmarks/results/fuzz.json.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from typing import Any

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
    options = parser.parse_args()
    results = {}
    for name, run in (
        ("firmware parser", fuzz_firmware),
        ("serial reader", fuzz_serial_reader),
        ("TCP decoder", fuzz_tcp_decoder),
    ):
        before_kb, start_s = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
        result = run(options.inputs, options.seed)
        grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb
        results[name] = {**result, "seconds": round(time.monotonic() - start_s, 1), "memory_grown_kb": grown_kb}
        print(f"{name}: {results[name]}", flush=True)
    folder = ROOT / "benchmarks" / "results"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fuzz.json").write_text(json.dumps(results, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
