"""What depth in every tenth frame makes of the recorded kitchen: its scale, and the walls of its plan.

    python -m benchmarks.bench_depth [--data ../shared/data/redkitchen] [--passes 0-398 500-698] [--results FILE]

Each pass is mapped by images alone (`sfm`) and gets its metres from depth. True poses judge:
- scale of the room: landmarks against the same points where depth has them from true poses.
- scale of the path: the camera's positions against the true ones. Where a camera turns much and moves little, a map
  that takes turning for moving shows another scale here than in what was seen (docs/studies/depth.md).
- walls: of the plan, in pieces of 10 cm, against the plan by depth alone from true poses; and the same of the map
  without its depth scans. Where depth has no points on its own wall, as behind the camera, neither plan knows of a wall
  and each ends where its view does: the pieces that have points are counted by themselves, too.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from benchmarks.result import Figure, Run, add_results_option
from station.datasets import open_dataset
from station.experiments.depth_truth import WallOffsets, align_by_depth, wall_offsets
from station.experiments.evaluation import best_scale
from station.places.rooms.plan import make_floor_plan
from station.slam.backends import make_backend
from station.slam.run import run_backend


def figures_of(folder: Path, first: int, last: int) -> list[Figure]:
    data = open_dataset(folder, first, last)
    assert data.truth is not None
    backend = make_backend("sfm", data.calibration, 0, 1, data.intrinsics_known)
    navigation = run_backend(backend, data.events())
    told = navigation.report.config["depth"]
    name = f"frames {first} to {last}"
    print(f"{name}: {navigation.report.scale}, {told}")
    room = align_by_depth(navigation, data.truth).scale
    path = best_scale(navigation.trajectory, data.truth)
    figures = [
        Figure(f"{name}: depth pictures", told["scans"]),
        Figure(f"{name}: scale is called metric", float(navigation.is_metric), at_least=1),
        Figure(f"{name}: scale error of the room", 100 * abs(room - 1), "%", at_most=2),
        Figure(f"{name}: scale error of the path", None if path is None else 100 * abs(path - 1), "%"),
        Figure(f"{name}: sigma told", 100 * told["sigma"], "%"),
    ]
    for kind, seen in (("", navigation), (" without depth's points", replace(navigation, depth=None))):
        walls = wall_offsets(navigation, make_floor_plan(seen, ()), data.truth)
        print(f"{name}{kind}: {walls.results()}")
        figures += wall_figures(f"{name}{kind}", walls, asked=not kind)
    return figures


def wall_figures(name: str, walls: WallOffsets, *, asked: bool) -> list[Figure]:
    found = walls.results()
    return [
        Figure(f"{name}: walls to depth's, median", found["median_m"], "m", at_most=0.05 if asked else None),
        Figure(f"{name}: walls to depth's, largest", found["greatest_m"], "m"),
        Figure(f"{name}: walls within 5 cm", found["within_5_cm"], at_least=1.0 if asked else None),
        Figure(f"{name}: walls that depth has points on", found["measured_m"], "m"),
        Figure(f"{name}: ... of them within 5 cm", found["measured_within_5_cm"]),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/redkitchen"))
    parser.add_argument("--passes", nargs="+", default=["0-398", "500-698"], help="First and last frame of each.")
    add_results_option(parser, "depth")
    options = parser.parse_args()
    run = Run.begin()
    figures = []
    for frames in options.passes:
        first, last = map(int, frames.split("-"))
        figures += figures_of(options.data, first, last)
    run.write(options.results, figures)


if __name__ == "__main__":
    main()
