"""Fit the numbers of floor plans (`station/places/rooms/fitted.json`) to flats mapped by SLAM, and write the file.

    python -m benchmarks.fit_rooms --worlds home:900-901 plain:900-902 --cache DIR

What walls and rooms look like is counted beside the simulator's truth. The four costs that are left are searched, along
one of them after the other, for the plans with the most rooms right, the largest overlap and the best doors. None of
these flats may be used to judge the result.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.room_flats import MappedRooms, mapped_rooms, parse_worlds
from benchmarks.room_truth import Judgement, judge
from robot.simulation.world import Room, World
from shared.disk import replace_file
from shared.geometry import FloatArray, IntArray, inverse_sim3, rotation_of, transform
from station.places.making.scale import units_per_metre
from station.places.rooms.plan import make_floor_plan, plan_along
from station.places.rooms.surfaces import (
    AREA_CLASSES,
    CLASSES,
    LINE_M,
    PIECE_M,
    UNSEEN,
    Seen,
    Surfaces,
    find_surfaces,
)
from station.places.rooms.wall_model import GENERATED, WallModel, wall_model

OFF_WALL_M = 0.2  # what counts as in a room, not at its walls
AROUND_M = 1.5  # the flat counts as outside
STEPS = (0.5, 0.7, 1.4, 2.0)  # of a cost, tried in each round
COSTS = ("gap", "gap_piece", "room", "area_weight")
SAMPLES = 400  # of each room, anywhere in it


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """A mapped flat and what was seen of it, in the axes of its plan."""

    mapped: MappedRooms
    R_ground_map: FloatArray
    surfaces: Surfaces

    @classmethod
    def of(cls, mapped: MappedRooms) -> Flat:
        R = make_floor_plan(mapped.place_map.navigation, ()).R_ground_map
        surfaces = find_surfaces(Seen.of(mapped.place_map.navigation, R))
        assert surfaces is not None
        return cls(mapped, R, surfaces)

    @property
    def unit(self) -> float:
        return units_per_metre(self.mapped.place_map.navigation)

    def on_ground(self, p_world: FloatArray) -> FloatArray:
        """(n, 2) m, of points (n, 2) of the world."""
        p = np.column_stack([p_world, np.zeros(len(p_world))])
        return (transform(inverse_sim3(self.mapped.T_world_map), p) @ self.R_ground_map.T)[:, :2] / self.unit

    def classes(self, p_world: FloatArray, inwards: FloatArray) -> IntArray:
        """(n,) of the pieces at points (n, 2) of the world, seen from the direction (2,)."""
        R = self.R_ground_map @ rotation_of(self.mapped.T_world_map).T
        d = (R @ np.append(inwards, 0.0))[:2]
        axis = int(abs(d[1]) > abs(d[0]))
        classes = self.surfaces.classes[axis, 1 if d[axis] > 0 else -1]
        p = self.on_ground(p_world) - self.surfaces.low
        plane = np.round(p[:, axis] / LINE_M).astype(np.int64)
        piece = np.floor(p[:, 1 - axis] / PIECE_M).astype(np.int64)
        inside = (plane >= 0) & (piece >= 0) & (plane < classes.shape[0]) & (piece < classes.shape[1])
        return np.asarray(classes[plane[inside], piece[inside]])


def count_pieces(flats: Sequence[Flat]) -> FloatArray:
    """(CLASSES,) log odds of a piece of wall against a piece anywhere in a room."""
    wall, inner = np.ones(CLASSES), np.ones(CLASSES)
    rng = np.random.default_rng(0)
    for flat in flats:
        for room in flat.mapped.world.rooms:
            for points, inwards in _walls(flat.mapped.world, room):
                wall += np.bincount(flat.classes(points, inwards), minlength=CLASSES)
            low, high = np.array([room.x0_m, room.y0_m]) + OFF_WALL_M, np.array([room.x1_m, room.y1_m]) - OFF_WALL_M
            for inwards in (np.array(d) for d in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))):
                points = rng.uniform(low, high, (SAMPLES // 4, 2))
                inner += np.bincount(flat.classes(points, inwards), minlength=CLASSES)
    odds = np.log(wall / wall.sum()) - np.log(inner / inner.sum())
    odds[UNSEEN] = 0.0  # without a landmark either: outside of flats all pieces are such, and nobody counted there
    return np.asarray(odds)


def _walls(world: World, room: Room) -> list[tuple[FloatArray, FloatArray]]:
    """Points (n, 2) along each wall of a room, but for its doors, and the direction (2,) into the room."""
    a, b, c, d = room.x0_m, room.y0_m, room.x1_m, room.y1_m
    found = []
    for p, q in (((a, b), (c, b)), ((c, b), (c, d)), ((c, d), (a, d)), ((a, d), (a, b))):
        begin, run = np.array(p), np.subtract(q, p)
        length = float(np.hypot(*run))
        points = begin + np.arange(0.5 * PIECE_M, length, PIECE_M)[:, None] * run / length
        for door in world.doors:
            along = 0 if door.along == "x" else 1
            off = np.abs(points - (door.x_m, door.y_m))
            points = points[(off[:, along] > door.width_m / 2) | (off[:, 1 - along] > 0.12)]
        found.append((points, np.array([-run[1], run[0]]) / length))
    return found


def count_cells(flats: Sequence[Flat]) -> FloatArray:
    """(AREA_CLASSES,) log odds of a cell in a room against one outside."""
    inside, outside = np.ones(AREA_CLASSES), np.ones(AREA_CLASSES)
    for flat in flats:
        x0, y0, x1, y1 = flat.mapped.world.bounds()
        x, y = (np.arange(a - AROUND_M, b + AROUND_M, PIECE_M) for a, b in ((x0, x1), (y0, y1)))
        p = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        is_room = np.zeros(len(p), dtype=np.bool_)
        for room in flat.mapped.world.rooms:
            is_room |= ((p >= (room.x0_m, room.y0_m)) & (p <= (room.x1_m, room.y1_m))).all(axis=1)
        cell = np.floor((flat.on_ground(p) - flat.surfaces.low) / PIECE_M).astype(np.int64)
        known = np.all((cell >= 0) & (cell < flat.surfaces.area_classes.shape), axis=1)
        classes = flat.surfaces.area_classes[tuple(cell[known].T)]
        inside += np.bincount(classes[is_room[known]], minlength=AREA_CLASSES)
        outside += np.bincount(classes[~is_room[known]], minlength=AREA_CLASSES)
    return np.asarray(np.log(inside / inside.sum()) - np.log(outside / outside.sum()))


def merit(flats: Sequence[Flat], model: WallModel) -> tuple[float, list[Judgement]]:
    """Mean over the flats of: number of rooms right, mean overlap, balance (F1) of doors found and wrong."""
    judged = []
    for flat in flats:
        plan = plan_along(flat.R_ground_map, flat.mapped.place_map.navigation, (), model)
        judged.append(judge(flat.mapped, plan))
    total = [j.is_count_right + np.mean(j.iou) + 2 * j.doors_found / max(j.doors + j.true_doors, 1) for j in judged]
    return float(np.mean(total)), judged


def search(flats: Sequence[Flat], model: WallModel, rounds: int) -> WallModel:
    """One cost after the other is made smaller or larger while that helps."""
    best, _ = merit(flats, model)
    for _ in range(rounds):
        before = best
        for cost in COSTS:
            trials = [msgspec.structs.replace(model, **{cost: getattr(model, cost) * step}) for step in STEPS]
            merits = [merit(flats, trial)[0] for trial in trials]
            k = int(np.argmax(merits))
            if merits[k] > best:
                best, model = merits[k], trials[k]
            print(f"{cost} {getattr(model, cost):.4g}: {best:.3f}", file=sys.stderr, flush=True)
        if best == before:
            break
    return model


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", required=True)
    parser.add_argument("--cache", type=Path, required=True, help="folder of mapped flats, outside of the repository")
    parser.add_argument("--rounds", type=int, default=3)
    a = parser.parse_args()
    names = parse_worlds(a.worlds, "slam")
    flats = [Flat.of(mapped) for mapped in (mapped_rooms(name, a.cache) for name in names) if mapped is not None]
    model = msgspec.structs.replace(
        wall_model(),
        made_by=f"python -m benchmarks.fit_rooms --worlds {' '.join(a.worlds)}",
        worlds=tuple(str(name) for name in names),
        wall=tuple(np.round(count_pieces(flats), 2).tolist()),
        area=tuple(np.round(count_cells(flats), 2).tolist()),
    )
    model = search(flats, model, a.rounds)
    model = msgspec.structs.replace(model, **{cost: float(f"{getattr(model, cost):.3g}") for cost in COSTS})
    replace_file(GENERATED, msgspec.json.format(msgspec.json.encode(model), indent=1) + b"\n")
    value, judged = merit(flats, model)
    print(f"{value:.3f}: rooms right {sum(j.is_count_right for j in judged)} of {len(judged)}")
    return 0


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        raise SystemExit(main())
