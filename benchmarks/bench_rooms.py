"""Are a flat's rooms, doors and walls found? Plans of simulated flats mapped by SLAM beside the simulator's truth.

    python -m benchmarks.bench_rooms --worlds home:600-609 plain:600-609 corner:600-609 large:600-604 [--cache DIR]
    python -m benchmarks.bench_rooms --recorded ../shared/data/redkitchen:0-398 ../shared/data/euroc_v1_01_keyframes

Flats are mapped where they are missing from the cache (room_flats.py; minutes each). One JSON line per flat; one
without a map counts as a flat with a wrong number of rooms. `--poses true`: the simulator's poses and depths instead
of SLAM's. A `corner` is a flat with an L-shaped room; an opening as wide as the arm of the L is no door. `--recorded`:
recordings, or frames of them, that show one room, mapped by `sfm`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.result import Figure, Run, add_results_option, share, work_folder
from benchmarks.room_flats import FlatName, mapped_rooms, parse_worlds
from benchmarks.room_truth import Judgement, judge
from station.datasets import open_dataset
from station.model.navigation import Navigation
from station.places.making.scale import ground_rotation, units_per_metre
from station.places.rooms.plan import make_floor_plan
from station.places.space.carving import FARTHEST_M, Carving
from station.places.space.sight import sights
from station.places.space.space import CELL_M
from station.slam.backends import make_backend
from station.slam.run import run_backend


@dataclass(frozen=True, slots=True)
class Row:
    name: FlatName
    judgement: Judgement | None  # None: SLAM made no map
    cpu_s: float  # of the plan
    keyframe_ms: tuple[float, ...] = ()  # CPU, of each keyframe's free space added to what was there

    def line(self) -> str:
        j = self.judgement
        if j is None:
            return json.dumps({"flat": str(self.name), "failed": "no map"})
        return json.dumps(
            {
                "flat": str(self.name),
                "rooms": f"{j.rooms} of {j.true_rooms}",
                "iou": [round(v, 2) for v in j.iou],
                "doors": f"{j.doors_found} of {j.true_doors}",
                "wrong_doors": j.doors - j.doors_found,
                "wall_error_m": round(float(np.median(j.wall_error_m)), 3) if j.wall_error_m else None,
                "wall_missed_m": round(float(np.median(j.wall_missed_m)), 3) if j.wall_missed_m else None,
                "cpu_s": round(self.cpu_s, 2),
                "keyframe_ms": round(float(np.percentile(self.keyframe_ms, 95)), 2) if self.keyframe_ms else None,
            }
        )


def run(name: FlatName, cache: Path) -> Row:
    mapped = mapped_rooms(name, cache)
    if mapped is None:
        return Row(name, None, 0.0)
    begin = time.process_time()
    plan = make_floor_plan(mapped.place_map.navigation, mapped.place_map.places)
    cpu_s = time.process_time() - begin
    return Row(name, judge(mapped, plan), cpu_s, _carved_ms(mapped.place_map.navigation))


def _carved_ms(navigation: Navigation) -> tuple[float, ...]:
    """CPU time of each keyframe, one after the other as while driving: how far it saw, and the cells before that."""
    R, metre = ground_rotation(navigation), units_per_metre(navigation)
    path = (navigation.keyframes.T_world_cam[:, :3, 3] @ R.T)[:, :2]
    carving = Carving.around(path[np.isfinite(path).all(axis=1)], metre, CELL_M)
    spent: list[float] = []
    coming = sights(navigation, R, FARTHEST_M * metre)
    next(coming, None)  # gathers the observations of all, which a drive has already
    while True:
        begin = time.process_time()
        sight = next(coming, None)
        if sight is None:
            return tuple(spent)
        carving.add(sight)
        spent.append(1e3 * (time.process_time() - begin))


def recorded_rooms(recording: str) -> int:
    """How many rooms the plan of a recording has, `FOLDER` or `FOLDER:FIRST-LAST`."""
    folder, _, frames = recording.partition(":")
    first, last = map(int, frames.split("-")) if frames else (None, None)
    data = open_dataset(Path(folder), first, last)
    backend = make_backend("sfm", data.calibration, 0, 1, data.intrinsics_known)
    return len(make_floor_plan(run_backend(backend, data.events()), ()).rooms)


def recorded_figure(recordings: list[str]) -> Figure:
    """Of recordings of one room each."""
    rooms = {Path(recording).name: recorded_rooms(recording) for recording in recordings}
    wrong = ", ".join(f"{name}: {count}" for name, count in rooms.items() if count != 1)
    right = sum(count == 1 for count in rooms.values())
    return share("recordings of one room whose plan has one", right, len(rooms), at_least=100, note=wrong)


def figures(rows: list[Row]) -> list[Figure]:
    """Over all flats against what was asked, then the number of rooms of each kind."""
    judged = [row.judgement for row in rows if row.judgement is not None]
    iou = [v for j in judged for v in j.iou]
    walls = [v for j in judged for v in j.wall_error_m]
    missed = [v for j in judged for v in j.wall_missed_m]
    right = sum(j.is_count_right for j in judged)
    doors, found = sum(j.doors for j in judged), sum(j.doors_found for j in judged)
    small = [row.cpu_s for row in rows if row.judgement is not None and row.judgement.true_rooms == 3]
    added = [ms for row in rows for ms in row.keyframe_ms]
    made = [
        share("flats whose number of rooms is right", right, len(rows), at_least=90),
        Figure("overlap (IoU) with the true room, median", _median(iou), at_least=0.8, of=len(iou)),
        share("doors found within 0.3 m", found, sum(j.true_doors for j in judged), at_least=90),
        share("doors of the plans that are none", doors - found, doors, at_most=5),
        Figure("walls of the plans to the nearest true wall, median", _median(walls), "m", at_most=0.1, of=len(judged)),
        Figure("true walls to the nearest wall of the plan, median", _median(missed), "m", of=len(judged)),
        Figure("CPU time of the plan of a three-room flat, largest", max(small, default=None), "s", at_most=3),
        Figure(
            "CPU time of one more keyframe's free space, 95th percentile",
            float(np.percentile(added, 95)) if added else None,
            "ms",
            at_most=10,
            of=len(added),
        ),
    ]
    for is_right, word in ((True, "right"), (False, "wrong")):
        sure = [c for j in judged for c, right in zip(j.certainty, j.is_right, strict=True) if right == is_right]
        mean = float(np.mean(sure)) if sure else None
        made.append(Figure(f"certainty of rooms, mean: of those that are {word}", mean, of=len(sure)))
    for kind in dict.fromkeys(row.name.world for row in rows):
        mine = [row for row in rows if row.name.world == kind]
        good = sum(row.judgement is not None and row.judgement.is_count_right for row in mine)
        made.append(share(f"number of rooms right: {kind}", good, len(mine)))
    return made


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=[])
    parser.add_argument("--recorded", nargs="+", default=[])
    parser.add_argument("--poses", choices=("slam", "true"), default="slam")
    parser.add_argument("--cache", type=Path, help="folder of mapped flats; usually in benchmarks/results/work")
    add_results_option(parser, "rooms")
    a = parser.parse_args()
    if not a.worlds and not a.recorded:
        parser.error("nothing to judge: give --worlds or --recorded")
    this_run = Run.begin()
    cache = a.cache or work_folder() / "room_flats"
    rows = []
    for name in parse_worlds(a.worlds, a.poses) if a.worlds else ():
        rows.append(run(name, cache))
        print(rows[-1].line(), flush=True)
    made = figures(rows) if rows else []
    made += [recorded_figure(a.recorded)] if a.recorded else []
    for figure in made:
        print(f"{figure.what}: {figure.value} {figure.unit}", file=sys.stderr)
    this_run.write(a.results, made)
    return 0


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        raise SystemExit(main())
