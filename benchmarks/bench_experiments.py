"""The thesis' experiments I, II and III on many simulated worlds, and the real kitchen: default and thesis mode, and
what geometry and appearance give alone.

    python -m benchmarks.bench_experiments [--seeds 30] [--first-seed 0]
        [--only I II III I-thesis kitchen kitchen-little] [--modes default geometry appearance thesis] [--eps 0.5 1.5]
        [--hours 1.0] [--work FOLDER] [--data ../shared/data] [--summary] [--results FILE]

Can be ended at any moment and started again: every world's navigations and results are files in the work folder
(usually in benchmarks/results/work), and what is there is not made again by the same code. `--hours` begins no further
world after that time. `--summary` only prints the table of what is there. All modes see the same two navigations (the
preset's backend, one thread, the world's seed).
`geometry` and `appearance` are the default mode with the clouds or the images as its only ground for a registration;
they may be added later to worlds that are there, at the price of the matching alone. What two navigations share is made
once: III's first navigation is II's, and I's second is the beginning of its first. `--eps` also matches with the
default mode's reach times these factors and counts the matches that change.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.places import changed_share
from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from shared.errors import RobotSystemError
from station.commands.experiment import backend_for, reconstruct
from station.datasets import Dataset, Truth
from station.experiments.experiment import Experiment, Story, results_dict, run_experiment
from station.experiments.inputs import FrameRange, Input, is_navigation, open_input, open_truth
from station.experiments.presets import PRESETS, Preset, SlamChoice, find_preset, make_dataset
from station.experiments.report import write_experiment
from station.files.navigation_folder import load_navigation, save_navigation
from station.model.frames import ImageFrame
from station.model.navigation import Navigation
from station.places.making.config import PlacesConfig, ThesisConfig
from station.slam.run import Events, run_backend

MODES = {  # by name: what is otherwise than in the default configuration
    "default": PlacesConfig(),
    "geometry": PlacesConfig(align_by="geometry"),
    "appearance": PlacesConfig(align_by="appearance"),
    "thesis": PlacesConfig(mode="thesis"),
}
KITCHEN = {
    "kitchen": (FrameRange(0, 398), FrameRange(500, 698)),
    "kitchen-little": (FrameRange(0, 198), FrameRange(200, 398)),
}
# Numbers with which the thesis' method finds any clusters in this cloud, tried by hand.
KITCHEN_THESIS = ThesisConfig(eps=0.05, min_pts=20, inlier_ratio=0.6)
SETS = (*PRESETS, *KITCHEN)
FLIGHTS = ("I", "I-thesis")
SAME_FIRST_DRIVE = {"III": "II"}


@dataclass(frozen=True, slots=True)
class Bounds:
    """What is asked of a set: the matches that are right and the co-visible places found, in percent, and the index."""

    right: float | None = None
    found: float | None = None
    rand: float | None = None


BOUNDS = {
    **dict.fromkeys(PRESETS, Bounds(right=95, found=85, rand=0.8)),
    "I-thesis": Bounds(),  # the thesis' own settings, to stand beside ours
    "kitchen": Bounds(right=95, found=70),
    "kitchen-little": Bounds(right=100),  # where little overlaps no match may be wrong
}


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Two reconstructed drives of one world."""

    navigations: list[Navigation]
    truths: tuple[Truth | None, Truth | None]
    thesis: ThesisConfig
    story: Story
    seconds: dict[str, float]  # what making them took, where they were made now


@dataclass(frozen=True, slots=True)
class Study:
    """What to run on every world."""

    modes: tuple[str, ...]
    eps_factors: tuple[float, ...]

    def is_done(self, folder: Path) -> bool:
        wanted = [f"{mode}.json" for mode in self.modes] + [f"eps_{factor:g}.json" for factor in self.eps_factors]
        return (folder / "failed.json").exists() or all((folder / name).exists() for name in wanted)


def open_world(name: str, seed: int, data: Path, folder: Path) -> World:
    """Both navigations and their truth, from an earlier start where they were finished."""
    seconds: dict[str, float] = {}
    if name in KITCHEN:
        thesis, story, choice = KITCHEN_THESIS, Story(title=f"Kitchen, {name}"), SlamChoice("sfm")
        inputs = [open_input(data / "redkitchen", frames, None) for frames in KITCHEN[name]]
        for number, opened in enumerate(inputs):
            navigation = folder / f"navigation{number + 1}"
            if is_navigation(navigation):
                inputs[number] = replace(opened, source=load_navigation(navigation))
    else:
        preset = find_preset(name, seed, data / "euroc_v1_02_imu" if name in FLIGHTS else None)
        thesis, story, choice = preset.thesis, preset.story, preset.slam
        if name in SAME_FIRST_DRIVE:
            _take_first_navigation(folder.with_name(f"{SAME_FIRST_DRIVE[name]}_{seed}"), folder)
        inputs = [_open_navigation(preset, number, folder) for number in (0, 1)]
        if preset.navigations[0] == preset.navigations[1] and isinstance(inputs[0].source, Dataset):
            inputs = _reconstruct_with_prefix(inputs[0], inputs[1], preset, seed, folder, seconds)
    navigations = reconstruct(inputs, choice, seed, 1, folder, seconds)
    for path in folder.glob("drive*/mav0/cam0/data"):
        shutil.rmtree(path)  # images, made again from the seed when wanted; the truth stays
    return World(navigations, (inputs[0].truth, inputs[1].truth), thesis, story, seconds)


def _open_navigation(preset: Preset, number: int, folder: Path) -> Input:
    """One navigation of a preset: finished, or simulated now."""
    same = preset.navigations[0] == preset.navigations[1]
    path, navigation = folder / f"drive{1 if same else number + 1}", folder / f"navigation{number + 1}"
    if is_navigation(navigation):
        return Input(path, load_navigation(navigation), open_truth(path))
    if not (path / "mav0" / "cam0" / "data").is_dir():
        shutil.rmtree(path, ignore_errors=True)
    return open_input(make_dataset(preset.navigations[number], path), preset.frames[number], None)


def _take_first_navigation(other: Path, folder: Path) -> None:
    """The same first navigation of another world's folder, where it is there: linked, not copied."""
    pairs = [(other / part, folder / part) for part in ("drive1", "navigation1")]
    if is_navigation(other / "navigation1") and not any(mine.exists() for _, mine in pairs):
        for theirs, mine in pairs:
            shutil.copytree(theirs, mine, copy_function=os.link)


def _reconstruct_with_prefix(
    whole: Input, prefix: Input, preset: Preset, seed: int, folder: Path, seconds: dict[str, float]
) -> list[Input]:
    """Both navigations of one navigation in one go: where the shorter ends, a copy of the process finishes it.

    The backend has seen the same until then, so the result is that of a run of its own.
    """
    assert isinstance(whole.source, Dataset)
    last = preset.frames[1].last
    assert last is not None
    data, start, is_copy = whole.source, time.perf_counter(), False

    def events() -> Events:
        nonlocal is_copy
        has_branched = False
        for event in data.events():
            if not has_branched and isinstance(event, ImageFrame) and event.index > last:
                child = os.fork()
                if child == 0:
                    is_copy = True
                    return
                os.waitpid(child, 0)  # waited for: what is spilled is shared
                has_branched = True
            yield event

    backend = backend_for(data, preset.slam, seed, 1)
    try:
        made = run_backend(backend, events())
        made = replace(made, id=f"{whole.path.name}-{made.id}")
        save_navigation(made, folder / f"navigation{2 if is_copy else 1}")
    except Exception:
        if not is_copy:
            raise
        traceback.print_exc()
    finally:
        if is_copy:
            os._exit(0)  # the rest of the program is the parent's, who misses the navigation if there is none
    seconds["navigation1"] = time.perf_counter() - start
    finished = [folder / f"navigation{number}" for number in (1, 2)]
    return [replace(i, source=load_navigation(f)) for i, f in zip((whole, prefix), finished, strict=True)]


def run_world(name: str, seed: int, data: Path, folder: Path, study: Study) -> None:
    """Its result files, or `failed.json` with the sentence why not."""
    try:
        world = open_world(name, seed, data, folder)
        base: Experiment | None = None
        for mode in study.modes:
            if (folder / f"{mode}.json").exists():
                continue
            done = _match(world, replace(MODES[mode], thesis=world.thesis), seed)
            base = done if mode == "default" else base
            if name in KITCHEN or seed == 0:
                write_experiment(done, folder / f"report-{mode}")
            _write(folder / f"{mode}.json", results_dict(done))
        for factor in study.eps_factors:
            base = base or _match(world, PlacesConfig(), seed)
            changed = changed_share(base, _match(world, PlacesConfig(eps_factor=factor), seed))
            _write(folder / f"eps_{factor:g}.json", {"changed": changed, "of": len(base.result.matches)})
    except RobotSystemError as exc:
        _write(folder / "failed.json", {"error": str(exc)})


def _match(world: World, config: PlacesConfig, seed: int) -> Experiment:
    first, second = world.navigations
    done = run_experiment(first, second, config, truths=world.truths, seed=seed, story=world.story)
    done.seconds.update(world.seconds)
    return done


def _write(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix(".new")
    scratch.write_text(json.dumps(content, indent=1, default=str) + "\n")
    scratch.rename(path)


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
        "rmse, normalised": median_rmse(rows),
        "rand index": float(np.median(rand)) if rand else None,
        "duplicates": sum(row["duplicate_places"] or 0 for row in rows) / places if places else None,
        "wrong seeds": wrong,
        "recall < 0.85 seeds": missed,
    }


def median_rmse(rows: list[dict[str, Any]]) -> float | None:
    """Of the accepted registrations; the map's cloud fills the unit ball, as in the thesis. None without any."""
    found = [row["registration"]["rmse_normalised"] for row in rows if row["registration"]["accepted"]]
    return float(np.median([rmse for rmse in found if rmse is not None])) if found else None


def results_in(work: Path, name: str, mode: str) -> dict[int, dict[str, Any]]:
    """The results of one set in one mode that are there, by their seeds."""
    files = sorted(work.glob(f"{name}_*/{mode}.json"), key=lambda path: _seed_of(path.parent))
    return {_seed_of(path.parent): json.loads(path.read_text()) for path in files}


def figures(work: Path, seeds: range) -> list[Figure]:
    """What is asked of the default mode in each set, and what the thesis mode reaches beside it."""
    found: list[Figure] = []
    duplicates = places = 0
    for name in SETS:
        for mode in ("default", "thesis"):
            rows = [row for seed, row in results_in(work, name, mode).items() if seed in seeds]
            if not rows:
                continue
            bounds = BOUNDS[name] if mode == "default" else Bounds()
            correct = [m["correct"] for row in rows for m in row["matches"] if m["correct"] is not None]
            co_visible = [len(row["co_visible"] or []) for row in rows]
            seen = sum((row["recall"] or 0.0) * n for row, n in zip(rows, co_visible, strict=True))
            title = f"{name}, {mode} mode, {len(rows)} worlds"
            found.append(share(f"{title}: co-visible places found", seen, sum(co_visible), at_least=bounds.found))
            found.append(Figure(f"{title}: RMSE of the registration, normalised, median", median_rmse(rows)))
            if mode == "default":
                found.append(
                    share(f"{title}: matches that are right", sum(correct), len(correct), at_least=bounds.right)
                )
                rand = [row["adjusted_rand_index"] for row in rows if row["adjusted_rand_index"] is not None]
                median = float(np.median(rand)) if rand else None
                found.append(
                    Figure(f"{title}: adjusted Rand index, median", median, at_least=bounds.rand, of=len(rand))
                )
                duplicates += sum(row["duplicate_places"] or 0 for row in rows)
                places += sum(row["places"] for row in rows)
    return [*found, share("places that are duplicates, default mode, all sets", duplicates, places, at_most=5)]


def print_summary(work: Path) -> None:
    """The table of everything that is there, as Markdown."""
    header: list[str] = []
    for name in SETS:
        for mode in MODES:
            results = results_in(work, name, mode)
            if not results:
                continue
            row = summarise(results)
            if not header:
                header = list(row)
                print("| set | mode | " + " | ".join(header) + " |")
                print("|" + " --- |" * (len(header) + 2))
            cells = (f"{v:.3g}" if isinstance(v, float) else "–" if v is None else str(v) for v in row.values())
            print(f"| {name} | {mode} | " + " | ".join(cells) + " |")
    for name in SETS:
        for factor in sorted({path.stem.removeprefix("eps_") for path in work.glob(f"{name}_*/eps_*.json")}):
            rows = [json.loads(path.read_text()) for path in sorted(work.glob(f"{name}_*/eps_{factor}.json"))]
            changed = sum((row["changed"] or 0.0) * row["of"] for row in rows)
            print(f"{name}: reach times {factor} changes {changed:.0f} of {sum(row['of'] for row in rows)} matches")
    for path in sorted(work.glob("*/failed.json")):
        print(f"failed: {path.parent.name}: {json.loads(path.read_text())['error']}")


def _seed_of(folder: Path) -> int:
    return int(folder.name.rsplit("_", 1)[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=list(SETS), choices=SETS)
    parser.add_argument("--modes", nargs="*", default=["default", "thesis"], choices=MODES)
    parser.add_argument("--eps", nargs="*", type=float, default=[], help="factors on the default mode's reach")
    parser.add_argument("--hours", type=float, default=float("inf"))
    parser.add_argument("--work", type=Path, help="where worlds are kept; usually in benchmarks/results/work")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--summary", action="store_true")
    add_results_option(parser, "experiments")
    a = parser.parse_args()
    run = Run.begin()
    work = a.work or work_folder() / "experiments"
    study = Study(tuple(mode for mode in MODES if mode in a.modes), tuple(a.eps))
    begun = time.monotonic()
    # Seed by seed through all sets, so that an early end leaves some worlds of each.
    worlds = [(name, seed) for seed in range(a.first_seed, a.first_seed + a.seeds) for name in a.only]
    for name, seed in () if a.summary else worlds:
        folder = work / f"{name}_{seed}"
        if study.is_done(folder) or (name in KITCHEN and seed > a.first_seed):  # the kitchen is one world
            continue
        if time.monotonic() - begun > 3600 * a.hours:
            break
        start = time.monotonic()
        run_world(name, seed, a.data, folder, study)
        print(f"{name} {seed}: {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
    print_summary(work)
    if not a.summary:
        run.write(a.results, figures(work, range(a.first_seed, a.first_seed + a.seeds)))


if __name__ == "__main__":
    main()
