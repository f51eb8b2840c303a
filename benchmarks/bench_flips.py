"""A thousand single wrong bits in a map store: each must be found and put right, or be harmless.

    python -m benchmarks.bench_flips --flips 1000

Every one has a seed and a line in a file; started again with the same code it goes on where it ended.
"""

from __future__ import annotations

import collections
import json
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.result import FOLDER, RESULTS_HELP, Run, share, work_folder
from tests.support.crashing.flips import flip_once, make_store

LOST = "LOST"
REPORT_EVERY = 50


def main(
    flips: Annotated[int, typer.Option(help="How many.")] = 1000,
    seed: Annotated[int, typer.Option(help="Of the first one; the next ones count up.")] = 1,
    rows: Annotated[
        Path | None,
        typer.Option(help="A line per flip; what is in there is not done again. Usually in benchmarks/results/work."),
    ] = None,
    results: Annotated[Path, typer.Option(help=RESULTS_HELP)] = FOLDER / "flips.json",
) -> None:
    """Exit code 1, naming the bit, when a wrong map opens or none does."""
    run = Run.begin()
    out = rows or work_folder() / "flips.jsonl"
    out.parent.mkdir(parents=True, exist_ok=True)
    wanted = range(seed, seed + flips)
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    done: dict[int, dict[str, object]] = {line["seed"]: line for line in lines if line["seed"] in wanted}
    begin_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="flips-") as scratch, out.open("a") as file:
        folder = Path(scratch)
        hashes = make_store(folder / "original")
        for flip_seed in wanted:
            if flip_seed in done:
                continue
            try:
                line = {
                    "seed": flip_seed,
                    "outcome": flip_once(folder / "original", hashes, folder / "flipped", flip_seed),
                }
            except Exception as exc:  # whatever it is: a person's map did not open
                line = {"seed": flip_seed, "outcome": LOST, "said": f"{exc!r}"}
                print(f"seed {flip_seed}: {exc!r}", flush=True)
            file.write(json.dumps(line) + "\n")
            file.flush()
            done[flip_seed] = line
            if len(done) % REPORT_EVERY == 0:
                print(f"{len(done)} flips, {time.monotonic() - begin_s:.0f} s", flush=True)
    for outcome, count in sorted(collections.Counter(str(line["outcome"]) for line in done.values()).items()):
        print(f"{count:5d} {outcome}")
    good = sum(line["outcome"] != LOST for line in done.values())
    run.write(results, [share("one wrong bit in a map store: put right, or harmless", good, len(done), at_least=100)])
    if good < len(done):
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
