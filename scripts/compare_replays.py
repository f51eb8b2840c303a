"""How runs of `station replay --out` differ: `python scripts/compare_replays.py BEFORE AFTER`, folders of such outputs.

Prints for each output that both folders have: whether its hashes are equal, the largest difference of positions and of
landmarks, and whether all answers name the same place in the same state.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from station.files.navigation_folder import load_navigation


def difference(before: Path, after: Path) -> str:
    """One line on two outputs of the same recording."""
    hashes = [json.loads((folder / "hashes.json").read_text()) for folder in (before, after)]
    equal = [name for name in hashes[0] if hashes[0][name] == hashes[1][name]]
    if len(equal) == len(hashes[0]):
        return "the same bits"
    first, second = (load_navigation(folder / "navigation") for folder in (before, after))
    p, q = (one.trajectory.T_world_body[:, :3, 3] for one in (first, second))
    moved = f"{np.abs(p - q).max():.1e} m" if p.shape == q.shape else f"{len(p)} and {len(q)} poses"
    a, b = (one.landmarks.p_world for one in (first, second))
    points = f"{np.abs(a - b).max():.1e} m" if a.shape == b.shape else f"{len(a)} and {len(b)}"
    said = [[json.loads(line) for line in (folder / "answers.jsonl").open()] for folder in (before, after)]
    other = sum((x["state"], _name(x)) != (y["state"], _name(y)) for x, y in zip(*said, strict=True))
    same = f"{', '.join(equal)} the same" if equal else "no hash the same"
    return f"{same}; poses {moved}, landmarks {points}, answers: {other} of {len(said[0])} differ"


def _name(answer: dict[str, dict[str, str] | None]) -> str:
    place = answer["place"]
    return "" if place is None else place["name"]


def main(before: Path, after: Path) -> None:
    for output in sorted(path.name for path in before.iterdir() if (path / "hashes.json").is_file()):
        if (after / output / "hashes.json").is_file():
            print(f"{output:16s} {difference(before / output, after / output)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
