"""Simulated flats with all their rooms mapped, for `bench_rooms`; what is in the cache is left alone.

    python -m benchmarks.room_flats --worlds small:900-905 plain:900-905 [--poses true] --cache DIR

Each flat is mapped by the `ukf` backend from a simulated mapping drive through every room, as `make_drives` does, but
with no room left out. `--poses true`: the simulator's own poses and depths stand for SLAM's (true_map.py).
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.bench_mapping import parse_seeds
from benchmarks.drive_cache import load, path_of, store
from benchmarks.true_map import map_truly
from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.world import World
from robot.simulation.worlds import make_world
from shared.errors import EstimationError
from shared.geometry import FloatArray
from station.model.place_map import PlaceMap
from station.workers.repeatable import repeatable
from tests.support.drives.misfit import Misfit
from tests.support.drives.recorded import RecordedWorld
from tests.support.drives.simulated import DriveOptions, SimulatedFlat, Spent

Poses = Literal["slam", "true"]
MAX_MAPPING_S = 600.0  # eight rooms take seven minutes


@dataclass(frozen=True, slots=True)
class FlatName:
    """One flat of the simulator, and how it is mapped."""

    world: str
    seed: int
    poses: Poses = "slam"

    def __str__(self) -> str:
        return f"{self.world} {self.seed}"

    def path(self, cache: Path) -> Path:
        return path_of(cache, self.world, str(self.seed), "rooms", self.poses)

    def world_of(self) -> World:
        return make_world(self.world, self.seed)


@dataclass(frozen=True, slots=True, eq=False)
class MappedRooms:
    """A flat's map beside the truth."""

    world: World
    place_map: PlaceMap
    T_world_map: FloatArray  # (4, 4) similarity


def parse_worlds(words: list[str], poses: Poses) -> list[FlatName]:
    """`plain:900-905` and the like; seed by seed, so that what is there when it ends early has all kinds in it."""
    wanted = [(word.partition(":")[0], parse_seeds(word.partition(":")[2])) for word in words]
    longest = max(len(seeds) for _, seeds in wanted)
    return [FlatName(name, seeds[i], poses) for i in range(longest) for name, seeds in wanted if i < len(seeds)]


def make(name: FlatName, cache: Path) -> str:
    """Map one flat and store it; returns a line about it."""
    begin = time.process_time()
    try:
        with repeatable(1):
            world = _by_truth(name) if name.poses == "true" else _by_slam(name)
        store(world, name.path(cache))
    except Exception:  # the other flats are still worth making
        return f"{name}: FAILED\n{traceback.format_exc()}"
    how = world.failure
    if world.place_map is not None and world.quality is not None:
        how = f"{len(world.place_map.navigation.keyframes)} keyframes, ATE {world.quality.error_m:.3f} m"
    return f"{name} ({name.poses}): {how}, {time.process_time() - begin:.0f} CPU s"


def mapped_rooms(name: FlatName, cache: Path) -> MappedRooms | None:
    """From the cache, made where it is missing; None where SLAM made no map."""
    if not name.path(cache).exists():
        print(make(name, cache), file=sys.stderr, flush=True)
    stored = load(name.path(cache))
    if stored.place_map is None:
        return None
    T = np.eye(4) if stored.quality is None else stored.quality.T_world_map
    return MappedRooms(name.world_of(), stored.place_map, T)


def _by_slam(name: FlatName) -> RecordedWorld:
    spent = Spent()
    flat = SimulatedFlat(name.world, name.seed, Misfit(), DriveOptions(max_seconds=MAX_MAPPING_S))
    try:
        with spent.on("mapping"):
            mapped = flat.mapped()
    except EstimationError as exc:
        return RecordedWorld(name.world, str(name.seed), "", "", None, str(exc), None, None, (), spent.cpu_s)
    return RecordedWorld(
        name.world, str(name.seed), "", "", mapped.place_map, "", mapped.quality, mapped.truth, (), spent.cpu_s
    )


def _by_truth(name: FlatName) -> RecordedWorld:
    calibration = simulated_calibration(SimulationConfig())
    assert calibration.camera is not None
    renderer = Renderer(name.world_of(), calibration.camera, default_cache_dir())
    place_map = map_truly(renderer, calibration, name.seed, MAX_MAPPING_S)
    return RecordedWorld(name.world, str(name.seed), "", "", place_map, "", None, None, ())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", required=True)
    parser.add_argument("--poses", choices=("slam", "true"), default="slam")
    parser.add_argument("--cache", type=Path, required=True, help="folder, outside of the repository")
    a = parser.parse_args()
    is_complete = True
    for name in parse_worlds(a.worlds, a.poses):
        if not name.path(a.cache).exists():
            line = make(name, a.cache)
            is_complete &= "FAILED" not in line
            print(line, flush=True)
    return 0 if is_complete else 1


if __name__ == "__main__":
    sys.exit(main())
