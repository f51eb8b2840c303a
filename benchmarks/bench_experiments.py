"""The thesis' experiments I, II and III on many simulated worlds, and the real kitchen, in both modes.

    python -m benchmarks.bench_experiments [--seeds 30] [--first-seed 0] [--only I II III kitchen kitchen-little]
                                           [--hours 1.0] [--work FOLDER] [--data ../shared/data] [--summary]

Can be ended at any moment and started again: every world's results are files in the work folder, and what is there is
not made again. `--hours` begins no further world after that time. `--summary` only prints the table of what is there.
Both modes see the same two navigations (structure from motion, one thread, the world's seed).
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shared.errors import RobotSystemError
from station.commands.experiment import make_drives, reconstruct
from station.experiments.experiment import Story, results_dict, run_experiment
from station.experiments.inputs import FrameRange, Input, is_navigation, open_input
from station.experiments.output import write_experiment
from station.experiments.presets import PRESETS, find_preset
from station.navigation import Navigation
from station.navigation_files import load_navigation
from station.places.config import PlacesConfig, PlacesMode, ThesisConfig

MODES: tuple[PlacesMode, ...] = ("default", "thesis")
KITCHEN = {  # thesis numbers that gave clusters at all on this cloud, tried by hand (docs/results.md)
    "kitchen": (FrameRange(0, 398), FrameRange(500, 698)),
    "kitchen-little": (FrameRange(0, 198), FrameRange(200, 398)),
}
KITCHEN_THESIS = ThesisConfig(eps=0.05, min_pts=20, inlier_ratio=0.6)
SETS = (*PRESETS, *KITCHEN)


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """Two drives of one world, before anything is reconstructed."""

    inputs: list[Input]
    thesis: ThesisConfig
    story: Story


def open_drives(name: str, seed: int, data: Path, folder: Path) -> Drives:
    """The recorded drives of a set; simulated ones are made first."""
    if name in KITCHEN:
        inputs = [open_input(data / "redkitchen", frames, None) for frames in KITCHEN[name]]
        return Drives(inputs, KITCHEN_THESIS, Story(title=f"Kitchen, {name}"))
    preset = find_preset(name, seed, data / "euroc_v1_02_imu" if name == "I" else None)
    paths = make_drives(preset, folder / "data")
    inputs = [open_input(path, frames, None) for path, frames in zip(paths, preset.frames, strict=True)]
    return Drives(inputs, preset.thesis, preset.story)


def navigations(drives: Drives, seed: int, folder: Path, seconds: dict[str, float]) -> list[Navigation]:
    """Both navigations, from an earlier start where they were finished."""
    kept = [folder / f"navigation{number}" for number in (1, 2)]
    if all(is_navigation(path) for path in kept):
        return [load_navigation(path) for path in kept]
    return reconstruct(drives.inputs, "sfm", seed, 1, folder, seconds)


def run_world(name: str, seed: int, data: Path, folder: Path) -> None:
    """Both modes on one world: `<mode>.json` in its folder, or `failed.json` with the sentence why not."""
    seconds: dict[str, float] = {}
    try:
        drives = open_drives(name, seed, data, folder)
        first, second = navigations(drives, seed, folder, seconds)
        for mode in MODES:
            done = run_experiment(
                first,
                second,
                PlacesConfig(mode=mode, thesis=drives.thesis),
                truths=(drives.inputs[0].truth, drives.inputs[1].truth),
                seed=seed,
                story=drives.story,
            )
            done.seconds.update(seconds)
            if name in KITCHEN or seed == 0:
                write_experiment(done, folder / f"report-{mode}")
            _write(folder / f"{mode}.json", results_dict(done))
    except RobotSystemError as exc:
        _write(folder / "failed.json", {"error": str(exc)})
    shutil.rmtree(folder / "data", ignore_errors=True)  # images, made again from the seed when wanted


def _write(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix(".new")
    scratch.write_text(json.dumps(content, indent=1, default=str) + "\n")
    scratch.rename(path)


def is_done(folder: Path) -> bool:
    return (folder / "failed.json").exists() or all((folder / f"{mode}.json").exists() for mode in MODES)


def summarise(results: dict[int, dict[str, Any]]) -> dict[str, Any]:
    """One row of the table: matches and co-visible places of all worlds together, medians of the rest."""
    rows = list(results.values())
    correct = [m["correct"] for row in rows for m in row["matches"] if m["correct"] is not None]
    co_visible = [len(row["co_visible"] or []) for row in rows]
    found = sum((row["recall"] or 0.0) * n for row, n in zip(rows, co_visible, strict=True))
    rand = [row["adjusted_rand_index"] for row in rows if row["adjusted_rand_index"] is not None]
    places = sum(row["places"] for row in rows)
    wrong = [s for s, row in results.items() if any(m["correct"] is False for m in row["matches"])]
    missed = [s for s, row in results.items() if row["recall"] is not None and row["recall"] < 0.85]
    return {
        "worlds": len(rows),
        "accepted": sum(bool(row["registration"]["accepted"]) for row in rows),
        "places/locations": f"{places / len(rows):.1f} / {sum(row['locations'] for row in rows) / len(rows):.1f}",
        "right/matches": f"{sum(correct)} / {len(correct)}",
        "precision": sum(correct) / len(correct) if correct else None,
        "found/co-visible": f"{found:.0f} / {sum(co_visible)}",
        "recall": found / sum(co_visible) if sum(co_visible) else None,
        "rand index": float(np.median(rand)) if rand else None,
        "duplicates": sum(row["duplicate_places"] or 0 for row in rows) / places if places else None,
        "wrong seeds": wrong,
        "recall < 0.85 seeds": missed,
    }


def print_summary(work: Path) -> None:
    """The table of everything that is there, as Markdown."""
    header: list[str] = []
    for name in SETS:
        for mode in MODES:
            files = sorted(work.glob(f"{name}_*/{mode}.json"), key=lambda path: _seed_of(path.parent))
            if not files:
                continue
            row = summarise({_seed_of(path.parent): json.loads(path.read_text()) for path in files})
            if not header:
                header = list(row)
                print("| set | mode | " + " | ".join(header) + " |")
                print("|" + " --- |" * (len(header) + 2))
            cells = (f"{v:.3f}" if isinstance(v, float) else "–" if v is None else str(v) for v in row.values())
            print(f"| {name} | {mode} | " + " | ".join(cells) + " |")
    for path in sorted(work.glob("*/failed.json")):
        print(f"failed: {path.parent.name}: {json.loads(path.read_text())['error']}")


def _seed_of(folder: Path) -> int:
    return int(folder.name.rsplit("_", 1)[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=list(SETS), choices=SETS)
    parser.add_argument("--hours", type=float, default=float("inf"))
    parser.add_argument("--work", type=Path, default=Path("benchmarks/results/experiments"))
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--summary", action="store_true")
    a = parser.parse_args()
    begun = time.monotonic()
    # Seed by seed through all sets, so that an early end leaves some worlds of each.
    worlds = [(name, seed) for seed in range(a.first_seed, a.first_seed + a.seeds) for name in a.only]
    for name, seed in () if a.summary else worlds:
        folder = a.work / f"{name}_{seed}"
        if is_done(folder) or (name in KITCHEN and seed > a.first_seed):  # the kitchen is one world
            continue
        if time.monotonic() - begun > 3600 * a.hours:
            break
        start = time.monotonic()
        run_world(name, seed, a.data, folder)
        print(f"{name} {seed}: {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
    print_summary(a.work)


if __name__ == "__main__":
    main()
