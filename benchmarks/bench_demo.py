"""The demo on many flats: a mapping drive, a hijack, a second drive, and the current place judged by the truth.

    python -m benchmarks.bench_demo [--seeds 1-20] [--backend ukf] [--results FILE]

Each is `station demo --once --seed N` by itself, in real time: two minutes and more. What each wrote is a line of a
file; started again with the same code it goes on where it ended.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.bench_mapping import parse_seeds
from benchmarks.result import Figure, Run, add_results_option, failed_seeds, rows_by_seed, share, work_folder

PASSED_PERCENT, PRECISION_PERCENT, MEDIAN_S = 100.0, 99.0, 110.0  # asked; flats are warm from the second run on


def run_demo(seed: int, backend: str) -> dict[str, Any]:
    """What the demo wrote of this flat; a demo that came to no end has not passed."""
    with tempfile.TemporaryDirectory(prefix="demo-") as folder:
        command = [sys.executable, "-m", "station.main", "demo", "--once", "--seed", str(seed), "--port", "0"]
        command += ["--out", folder, *(["--backend", backend] if backend else [])]
        done = subprocess.run(command, capture_output=True, text=True)
        written = Path(folder) / "results.json"
        if not written.exists():
            return {"seed": seed, "passed": False, "said": (done.stdout + done.stderr).strip()[-500:]}
        result: dict[str, Any] = json.loads(written.read_text())
        return result


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """How many flats passed, how many answers were right, how true the maps are."""
    judged = [row for row in rows if "right" in row]
    right, wrong = (sum(row[key] for row in judged) for key in ("right", "wrong"))
    passed = sum(row["passed"] for row in rows)
    not_known = sum(row["not_known"] for row in judged)
    worst_m = max((row["map_error_m"] for row in judged), default=None)
    seconds = [row["seconds"]["total"] for row in judged]
    return [
        share("demo: flats that passed", passed, len(rows), at_least=PASSED_PERCENT, note=failed_seeds(rows, why_not)),
        share("demo: known answers that are right", right, right + wrong, at_least=PRECISION_PERCENT),
        share("demo: answers that are known", right + wrong, right + wrong + not_known),
        Figure("demo: error of the map, worst", worst_m, "m", of=len(judged)),
        Figure("demo: on the clock, median", median(seconds) if seconds else None, "s", MEDIAN_S, of=len(judged)),
    ]


def why_not(row: dict[str, Any]) -> str:
    return str(row.get("shortfall") or row["said"])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1-20")
    parser.add_argument("--backend", default="", help="ukf or sfm; otherwise what the demo chooses")
    parser.add_argument("--rows", type=Path, help="a line per flat; usually in benchmarks/results/work")
    add_results_option(parser, "demo")
    options = parser.parse_args()
    run = Run.begin()
    kept: Path = options.rows or work_folder() / f"demo{options.backend}.jsonl"
    rows = rows_by_seed(kept, parse_seeds(options.seeds), lambda seed: run_demo(seed, options.backend))
    run.write(options.results, figures(rows))
    return 0 if all(row["passed"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
