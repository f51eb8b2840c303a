"""A thousand single wrong bits in a map store: each must be found and put right, or be harmless.

python benchmarks/bench_flips.py --flips 1000
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.flips import flip_many


def main(
    flips: Annotated[int, typer.Option(help="How many.")] = 1000,
    seed: Annotated[int, typer.Option(help="Of the first one; the next ones count up.")] = 1,
) -> None:
    """Raises AssertionError, naming the bit, when a wrong map opens or none does."""
    with tempfile.TemporaryDirectory(prefix="flips-") as folder:
        for outcome, count in sorted(flip_many(flips, seed, Path(folder)).items()):
            print(f"{count:5d} {outcome}")


if __name__ == "__main__":
    typer.run(main)
