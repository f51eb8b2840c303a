"""Fit the numbers of floor plans (`station/places/rooms/fitted.json`) to flats mapped by SLAM, and write the file.

    python -m benchmarks.fit_rooms --worlds home:900-901 plain:900-902 --cache DIR [--feet]

What walls and rooms look like is counted beside the simulator's truth. The six costs that are left are those with
which the true rooms are worth more than any other set of rectangles that is found, by a margin that grows with how
wrong that set is (structured support vector machine with cutting planes: Tsochantaridis et al., JMLR 2005). None of
these flats may be used to judge the result.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from scipy.optimize import linear_sum_assignment, minimize, minimize_scalar
from threadpoolctl import threadpool_limits

from benchmarks.room_flats import MappedRooms, mapped_rooms, parse_worlds
from robot.simulation.world import Room, World
from shared.disk import replace_file
from shared.geometry import FloatArray, IntArray, inverse_sim3, rotation_of, transform
from station.places.making.scale import units_per_metre
from station.places.rooms.feet import FOOT_CLASSES
from station.places.rooms.feet import UNSEEN as FOOT_UNSEEN
from station.places.rooms.plan import gathered_surfaces, make_floor_plan
from station.places.rooms.rectangles import SAME, Rectangle, find_rectangles
from station.places.rooms.sides import Sides, gap_costs, gaps_of, weigh_sides
from station.places.rooms.surfaces import (
    AREA_CLASSES,
    CLASSES,
    LINE_M,
    PIECE_M,
    SIDES,
    UNSEEN,
    Side,
    Surfaces,
)
from station.places.rooms.wall_model import GENERATED, WallModel, wall_model

OFF_WALL_M = 0.2  # what counts as in a room, not at its walls
AROUND_M = 1.5  # the flat counts as outside
NEAR = 3  # planes to either side of a true wall
COSTS = ("door", "opening", "gap", "gap_piece", "room", "area_weight")
MARGIN = 100.0  # nats by which true rooms should be ahead of what is wholly wrong
STAY = 5.0  # nats by which a step to e times a cost must pay
ROUNDS = 6
SIMPLEX = {"maxiter": 3000, "xatol": 1e-3, "fatol": 1e-3}
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
        surfaces = gathered_surfaces(mapped.place_map.navigation, R)
        assert surfaces is not None
        return cls(mapped, R, surfaces)

    @property
    def unit(self) -> float:
        return units_per_metre(self.mapped.place_map.navigation)

    def on_ground(self, p_world: FloatArray) -> FloatArray:
        """(n, 2) m, of points (n, 2) of the world."""
        p = np.column_stack([p_world, np.zeros(len(p_world))])
        return (transform(inverse_sim3(self.mapped.T_world_map), p) @ self.R_ground_map.T)[:, :2] / self.unit

    def classes(self, of: dict[Side, IntArray], p_world: FloatArray, inwards: FloatArray) -> IntArray:
        """(n,) those `of` the pieces at points (n, 2) of the world, seen from the direction (2,)."""
        R = self.R_ground_map @ rotation_of(self.mapped.T_world_map).T
        d = (R @ np.append(inwards, 0.0))[:2]
        axis = int(abs(d[1]) > abs(d[0]))
        classes = of[axis, 1 if d[axis] > 0 else -1]
        p = self.on_ground(p_world) - self.surfaces.low
        plane = np.round(p[:, axis] / LINE_M).astype(np.int64)
        piece = np.floor(p[:, 1 - axis] / PIECE_M).astype(np.int64)
        inside = (plane >= 0) & (piece >= 0) & (plane < classes.shape[0]) & (piece < classes.shape[1])
        return np.asarray(classes[plane[inside], piece[inside]])


def count_pieces(flats: Sequence[Flat]) -> FloatArray:
    """(CLASSES,) log odds of a piece of wall against a piece anywhere in a room."""
    odds = _odds(flats, [flat.surfaces.classes for flat in flats], CLASSES)
    odds[UNSEEN] = 0.0  # without a landmark either: outside of flats all pieces are such, and nobody counted there
    return odds


def count_feet(flats: Sequence[Flat]) -> FloatArray:
    """(FOOT_CLASSES,) the same of their feet; of flats without pictures nothing."""
    seen = [flat for flat in flats if flat.surfaces.feet is not None]
    odds = _odds(seen, [flat.surfaces.feet for flat in seen if flat.surfaces.feet is not None], FOOT_CLASSES)
    odds[FOOT_UNSEEN] = 0.0
    return odds


def _odds(flats: Sequence[Flat], classes: Sequence[dict[Side, IntArray]], num_classes: int) -> FloatArray:
    """(num_classes,) log odds of a piece of wall against a piece anywhere in a room."""
    wall, inner = np.ones(num_classes), np.ones(num_classes)
    rng = np.random.default_rng(0)
    for flat, of in zip(flats, classes, strict=True):
        for room in flat.mapped.world.rooms:
            for points, inwards in _walls(flat.mapped.world, room):
                wall += np.bincount(flat.classes(of, points, inwards), minlength=num_classes)
            low, high = np.array([room.x0_m, room.y0_m]) + OFF_WALL_M, np.array([room.x1_m, room.y1_m]) - OFF_WALL_M
            for inwards in (np.array(d) for d in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))):
                points = rng.uniform(low, high, (SAMPLES // 4, 2))
                inner += np.bincount(flat.classes(of, points, inwards), minlength=num_classes)
    return np.asarray(np.log(wall / wall.sum()) - np.log(inner / inner.sum()))


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


def true_rectangles(flat: Flat, sides: Sides, model: WallModel) -> list[Rectangle]:
    """The true rooms on the nearby planes that suit them best: maps are bent."""
    found = []
    for room in flat.mapped.world.rooms:
        corners = np.array(list(itertools.product((room.x0_m, room.x1_m), (room.y0_m, room.y1_m))))
        at = np.sort((flat.on_ground(corners) - flat.surfaces.low) / LINE_M, axis=0)
        planes = [round(float(at[half, axis].mean())) for axis in (0, 1) for half in (slice(2), slice(2, 4))]
        for k in [*range(4)] * 2:
            near = [[*planes[:k], planes[k] + step, *planes[k + 1 :]] for step in range(-NEAR, NEAR + 1)]
            planes = max(near, key=lambda p: score(Rectangle(*p), sides, model))
        found.append(Rectangle(*planes))
    return found


def score(r: Rectangle, sides: Sides, model: WallModel) -> float:
    return float(worth([r], sides, model) @ _weights([getattr(model, cost) for cost in COSTS]))


def worth(rectangles: Sequence[Rectangle], sides: Sides, model: WallModel) -> FloatArray:
    """(7,) what a set of rectangles gains from walls, then how often each of the costs counts."""
    total = np.zeros(1 + len(COSTS))
    for r in rectangles:
        for side in SIDES:
            plane, pieces = r.plane(side), r.pieces(side[0])
            is_wall = sides.is_wall[side][plane, pieces]
            total[0] += sides.odds[side][plane, pieces][is_wall].sum()
            for begin, end in gaps_of(sides.is_wall[side][plane]):  # those at the ends count in part
                part = max(min(end, pieces.stop) - max(begin, pieces.start), 0) / (end - begin)
                cost = gap_costs(np.array([end - begin]), model)[0]
                is_door, is_opening = cost == model.door, cost == model.opening
                is_other = not (is_door or is_opening)
                total[1:5] += part * np.array([is_door, is_opening, is_other, is_other * (end - begin)])
        area = sides.area[r.x1, r.y1] - sides.area[r.x0, r.y1] - sides.area[r.x1, r.y0] + sides.area[r.x0, r.y0]
        total[5:] += np.array([1.0, area / model.area_weight])
    return total


def _weights(costs: Sequence[float]) -> FloatArray:
    return np.array([1.0, *(-cost for cost in costs[:-1]), costs[-1]])


def wrongness(true: Sequence[Rectangle], found: Sequence[Rectangle]) -> float:
    """1 - the mean overlap of rectangles assigned to each other; one too many or too few overlaps nothing."""
    overlap = np.array([[a.overlap(b) for b in found] for a in true]).reshape(len(true), len(found))
    rows, columns = linear_sum_assignment(-overlap)
    return 1.0 - float(overlap[rows, columns].sum()) / max(len(true), len(found))


def fit_costs(flats: Sequence[Flat], model: WallModel) -> WallModel:
    """The best costs of a few rounds: in each, what the packing finds instead of the true rooms is to be outbid."""
    rivals: list[tuple[int, FloatArray, float]] = []  # flat, what it lacks to the true rooms, how wrong it is
    least, best = np.inf, model
    for _ in range(ROUNDS):
        wrong = []
        for number, flat in enumerate(flats):
            sides = weigh_sides(flat.surfaces, model)
            true, found = true_rectangles(flat, sides, model), find_rectangles(flat.surfaces, sides, model).rectangles
            wrong.append(wrongness(true, found))
            rivals.append((number, worth(true, sides, model) - worth(found, sides, model), wrong[-1]))
        costs = ", ".join(f"{cost} {getattr(model, cost):.3g}" for cost in COSTS)
        print(f"{costs}: wrong {np.mean(wrong):.3f} {np.round(wrong, 2).tolist()}", file=sys.stderr, flush=True)
        if np.mean(wrong) < least:
            least, best = float(np.mean(wrong)), model
        begin = np.log([getattr(best, cost) for cost in COSTS])
        solved = minimize(_regret, begin, args=(begin, rivals, len(flats)), method="Nelder-Mead", options=SIMPLEX)
        model = msgspec.structs.replace(
            model, **dict(zip(COSTS, (float(f"{c:.3g}") for c in np.exp(solved.x)), strict=True))
        )
    return best


def _regret(
    log_costs: FloatArray, near: FloatArray, rivals: Sequence[tuple[int, FloatArray, float]], count: int
) -> float:
    """Mean over the flats of the worst lack of margin, and how far the costs are from the best so far.

    What the rivals are was found at other costs and holds near them only (a proximal bundle method).
    """
    weights = _weights(np.exp(log_costs).tolist())
    worst = np.zeros(count)
    for number, lacks, wrong in rivals:
        worst[number] = max(worst[number], MARGIN * wrong - float(lacks @ weights))
    return float(worst.mean() + STAY * ((log_costs - near) ** 2).sum())


def fit_lead(flats: Sequence[Flat], model: WallModel) -> float:
    """Nats per unit of log odds with which the rectangles' leads predict best which of them are true rooms."""
    lead: list[float] = []
    is_right: list[bool] = []
    for flat in flats:
        sides = weigh_sides(flat.surfaces, model)
        true, found = true_rectangles(flat, sides, model), find_rectangles(flat.surfaces, sides, model)
        lead += found.lead
        is_right += [max(r.overlap(other) for other in true) > SAME for r in found.rectangles]
    signed = np.where(is_right, -1.0, 1.0) * np.array(lead)
    solved = minimize_scalar(
        lambda log: np.logaddexp(0.0, signed / np.exp(log)).sum(), bounds=(-3, 6), method="bounded"
    )
    print(f"{np.count_nonzero(is_right)} of {len(lead)} rectangles are rooms", file=sys.stderr)
    return float(np.exp(solved.x))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", required=True)
    parser.add_argument("--cache", type=Path, required=True, help="folder of mapped flats, outside of the repository")
    parser.add_argument("--feet", action="store_true", help="count the feet of walls alone; all else stays as it is")
    a = parser.parse_args()
    names = parse_worlds(a.worlds, "slam")
    flats = [Flat.of(mapped) for mapped in (mapped_rooms(name, a.cache) for name in names) if mapped is not None]
    before = wall_model()
    command = f"python -m benchmarks.fit_rooms --worlds {' '.join(a.worlds)}"
    if a.feet:
        worlds = tuple(dict.fromkeys([*before.worlds, *(str(name) for name in names)]))
        foot = tuple(np.round(count_feet(flats), 2).tolist())
        made_by = f"{before.made_by.partition('; ')[0]}; {command} --feet"
        _write(msgspec.structs.replace(before, made_by=made_by, worlds=worlds, foot=foot))
        return 0
    model = msgspec.structs.replace(
        before,
        made_by=command,
        worlds=tuple(str(name) for name in names),
        foot=tuple(np.round(count_feet(flats), 2).tolist()),
        wall=tuple(np.round(count_pieces(flats), 2).tolist()),
        area=tuple(np.round(count_cells(flats), 2).tolist()),
    )
    model = fit_costs(flats, model)
    model = msgspec.structs.replace(model, lead=float(f"{fit_lead(flats, model):.3g}"))
    _write(model)
    return 0


def _write(model: WallModel) -> None:
    replace_file(GENERATED, msgspec.json.format(msgspec.json.encode(model), indent=1) + b"\n")


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        raise SystemExit(main())
