"""Kill -9 at random moments while recording, saving, renaming, merging and migrating: is anything lost?

    python benchmarks/bench_crash.py --kills 600

Every kill has a seed, printed and kept in benchmarks/results/crash.jsonl; started again it goes on where it ended.
"""

from __future__ import annotations

import collections
import json
import tempfile
import time
import traceback
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.crashes import SCENARIOS, run_once

RESULTS = Path(__file__).parent / "results" / "crash.jsonl"


def main(
    kills: Annotated[int, typer.Option(help="In all, over the scenarios in turn.")] = 600,
    seed: Annotated[int, typer.Option(help="Of the first kill; the next ones count up.")] = 1,
    only: Annotated[str, typer.Option(help="One scenario.")] = "",
    out: Annotated[Path, typer.Option(help="Results, a line per kill; what is in there is not done again.")] = RESULTS,
) -> None:
    """Exit code 1 when anything was lost."""
    out.parent.mkdir(parents=True, exist_ok=True)
    done = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    seen = {(line["scenario"], line["seed"]) for line in done}
    names = [only] if only else list(SCENARIOS)
    with tempfile.TemporaryDirectory(prefix="crash-") as scratch, out.open("a") as file:
        for number in range(kills):
            name, kill_seed = names[number % len(names)], seed + number
            if (name, kill_seed) in seen:
                continue
            begin_s = time.monotonic()
            try:
                said, is_good = run_once(name, Path(scratch) / "work", kill_seed), True
            except Exception as exc:
                said, is_good = f"{exc!r}", False
                traceback.print_exc()
            took_s = time.monotonic() - begin_s
            line = {"scenario": name, "seed": kill_seed, "good": is_good, "said": said}
            file.write(json.dumps(line) + "\n")
            file.flush()
            done.append(line)
            print(f"{name:10s} seed {kill_seed}: {'ok' if is_good else 'LOST'}, {said} ({took_s:.1f} s)")
    counts = collections.Counter((line["scenario"], line["good"]) for line in done)
    for name in SCENARIOS:
        print(f"{name:10s} {counts[name, True]} kills without loss, {counts[name, False]} with")
    if any(not line["good"] for line in done):
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
