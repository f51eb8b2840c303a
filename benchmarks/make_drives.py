"""Make recorded drives with truth for `bench_current_place` and for fitting the belief; what is there is left alone.

    python -m benchmarks.make_drives --kinds small,plain --seeds 900-905 [--wrong-focal 2] [--one-way]
        [--map-all [--identical]] [--jobs N] --cache DIR

Each world is mapped by the `ukf` backend from a simulated mapping drive, one room left out, and driven through again
three times, each with a hijack. Whoever maps goes once each way round every room, as the page asks (`--one-way`: one
way only). `--map-all`: of flats with twin rooms no room is left out, and the robot is put down in either twin, twice;
`--identical`: these have the same pictures, too. `--wrong-focal P`: the robot is built otherwise than it says, by P %
in focal length and wheels, and P/2 times 1 degree, 1 cm and 5 ms in the camera's mounting and time
(tests/support/drives/misfit.py).
One process per core. Every world's line says how true its map is and what it cost.
"""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import zip_longest
from multiprocessing import get_context
from pathlib import Path

from benchmarks.drive_cache import path_of, store
from station.workers.repeatable import repeatable
from tests.support.drives import real
from tests.support.drives.misfit import Misfit
from tests.support.drives.recorded import RecordedWorld
from tests.support.drives.simulated import DriveOptions, make_drives
from tests.support.likelihood_fit import numbers


@dataclass(frozen=True, slots=True)
class Job:
    """One world to make."""

    kind: str
    name: str  # the seed, or the recordings
    misfit: Misfit
    options: DriveOptions
    cache: Path

    @property
    def path(self) -> Path:
        if self.kind == real.KIND:
            return path_of(self.cache, self.kind, self.name)
        o = self.options
        how = (
            "slam" if o.with_slam else "",
            "" if o.both_ways else "one-way",
            "all" if o.maps_all else "",
            "identical" if o.identical_twins else "",
        )
        return path_of(self.cache, self.kind, self.name, self.misfit.name, *how)

    def make(self) -> RecordedWorld:
        if self.kind == real.KIND:
            return real.make_real(self.name)
        return make_drives(self.kind, int(self.name), self.misfit, self.options)


def run(job: Job) -> str:
    """Make and store one world; returns a line about it."""
    try:
        with repeatable(1):
            world = job.make()
        store(world, job.path)
    except Exception:  # the other worlds are still worth making
        return f"{job.kind} {job.name} {job.misfit.name}: FAILED\n{traceback.format_exc()}"
    return described(world)


def jobs_of(kind: str, seeds: Sequence[int], wrong_focal: float, options: DriveOptions, cache: Path) -> list[Job]:
    """Worlds of a kind; of real ones all recordings, whatever the seeds."""
    if kind == real.KIND:
        return [Job(kind, name, Misfit(), options, cache) for name in real.CASES]
    return [Job(kind, str(seed), Misfit(wrong_focal, seed), options, cache) for seed in seeds]


def make_missing(jobs: Iterable[Job], processes: int) -> bool:
    """Make what is not in the cache; whether all could be made."""
    missing = [job for job in jobs if not job.path.exists()]
    print(f"{len(missing)} worlds to make", flush=True)
    is_complete = True
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        for line in pool.map(run, missing):
            is_complete &= "FAILED" not in line
            print(line, flush=True)
    return is_complete


def described(world: RecordedWorld) -> str:
    """How true the map is, how many images there are, what it cost."""
    name = f"{world.kind} {world.name} {world.misfit}"
    cost = f"{sum(world.cpu_s.values()):.0f} CPU s {world.cpu_s}"
    if world.place_map is None or world.quality is None:
        return f"{name}: no map ({world.failure}), {cost}"
    quality, keyframes = world.quality, len(world.place_map.navigation.keyframes)
    images = [image for drive in world.drives for image in drive.images]
    found = sum(bool(image.attempt.candidates) for image in images)
    return (
        f"{name}: scale {quality.scale:.4f}, ATE {quality.error_m:.3f} m, lost {quality.lost_s:.1f} s, "
        f"{keyframes} keyframes, {len(world.place_map.places)} places, "
        f"{found} of {len(images)} images localised, {cost}"
    )


def add_mapping_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--one-way", action="store_true", help="whoever maps goes one way round every room only")
    parser.add_argument("--map-all", action="store_true", help="no room is left out; hijacks go into twin rooms")
    parser.add_argument("--identical", action="store_true", help="nothing within twin rooms tells them apart")


def options_of(a: argparse.Namespace, with_slam: bool = False) -> DriveOptions:
    """As the mapping options say."""
    return DriveOptions(with_slam=with_slam, both_ways=not a.one_way, maps_all=a.map_all, identical_twins=a.identical)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="small", help="worlds of the simulator, or real; with commas between")
    parser.add_argument("--seeds", type=numbers, default=numbers("900-905"))
    parser.add_argument("--wrong-focal", type=float, default=0.0, help="per cent")
    parser.add_argument("--with-slam", action="store_true", help="a running SLAM gives the drives' odometry")
    add_mapping_option(parser)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--cache", type=Path, required=True, help="folder, outside of the repository")
    a = parser.parse_args()
    options = options_of(a, a.with_slam)
    by_kind = [jobs_of(kind, a.seeds, a.wrong_focal, options, a.cache) for kind in a.kinds.split(",")]
    # Seed by seed, so that what is there when it is ended early has all kinds in it.
    jobs = [job for same_seed in zip_longest(*by_kind) for job in same_seed if job is not None]
    return 0 if make_missing(jobs, a.jobs) else 1


if __name__ == "__main__":
    sys.exit(main())
