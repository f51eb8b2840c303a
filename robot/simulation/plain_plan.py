"""Floor plans of plain homes: rooms off a corridor, an open living space with rooms off it, or rooms in a row.

Two more by name: `corner`, with an L-shaped living room, and `large`, six to eight rooms off a long corridor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from robot.simulation.world import WALL_THICKNESS_M, Door

SOUTH, EAST, NORTH, WEST = range(4)  # sides of a room, in the order of walls.wall_runs
DOOR_WIDTHS_M = (0.8, 0.95)
WIDE_OPENING_M = (1.6, 2.3)
DOOR_TO_CORNER_M = 0.2  # of the opening
TWIN_SHARE = 0.35  # of the homes that could have twin rooms

Cell = tuple[float, float, float, float]  # x0 y0 x1 y1 m, to the middle of the walls


@dataclass(frozen=True, slots=True)
class PlannedRoom:
    cell: Cell
    use: str  # what it is furnished as
    window_side: int | None
    part_of: int | None = None  # the planned room that this rectangle makes L-shaped


@dataclass(frozen=True, slots=True)
class Plan:
    rooms: tuple[PlannedRoom, ...]
    doors: tuple[Door, ...]
    twins: tuple[int, int] | None = None  # two rooms of one shape, door and use
    closed: tuple[Cell, ...] = ()  # parts of the building behind doors that never open


def draw_plan(rng: np.random.Generator, needs_twins: bool, name: str = "plain") -> Plan:
    """A plan by chance; with twin rooms where they are needed, else now and then."""
    if name in ("corner", "large"):
        return _corner(rng) if name == "corner" else _large(rng)
    kinds: list[Callable[[np.random.Generator, bool], Plan | None]] = [_corridor, _open_plan]
    has_twins = needs_twins or bool(rng.random() < TWIN_SHARE)
    if not needs_twins:
        kinds.append(_row)
    kind = kinds[int(rng.integers(0, len(kinds)))]
    while True:
        plan = kind(rng, has_twins)
        if plan is not None:
            return plan


def _widths(rng: np.random.Generator, count: int, has_twins: bool, low: float, high: float) -> list[float]:
    widths = [float(w) for w in rng.uniform(low, high, count)]
    if has_twins:
        widths[1] = widths[0]
    return widths


def _side_by_side(widths: list[float], y0: float, y1: float) -> list[Cell]:
    ends = np.concatenate([[0.0], np.cumsum(widths)])
    return [(float(a), y0, float(b), y1) for a, b in pairwise(ends)]


def _corridor(rng: np.random.Generator, has_twins: bool) -> Plan:
    """A corridor with two or three rooms on its north side, one or two on its south side, and closed doors."""
    north = _widths(rng, int(rng.integers(2, 4)), has_twins, 2.7, 3.9)
    south = _widths(rng, 1 if len(north) == 3 else int(rng.integers(1, 3)), False, 3.0, 4.6)
    south_depth, north_depth, width = (float(v) for v in rng.uniform([3.0, 2.9, 1.3], [4.2, 4.4, 1.7]))
    length = max(sum(north), sum(south))
    north[-1] += length - sum(north) if not (has_twins and len(north) == 2) else 0.0
    door_m = float(rng.uniform(*DOOR_WIDTHS_M))
    hall = (0.0, south_depth, length, south_depth + width)
    cells_south = _side_by_side(south, 0.0, south_depth)
    cells_north = _side_by_side(north, hall[3], hall[3] + north_depth)
    uses = ["living room", "kitchen"][: len(south)] + (["bedroom", "bedroom"] if has_twins else ["bedroom", "study"])
    uses += ["guest room"][: len(north) - 2]
    rooms = [PlannedRoom(hall, "hall", WEST if rng.random() < 0.5 else None)]
    doors: list[Door] = []
    shift = _door_place(rng, north[0], door_m)
    for index, cell in enumerate([*cells_south, *cells_north]):
        is_north = index >= len(south)
        is_twin = has_twins and is_north and index - len(south) < 2
        x = cell[0] + (shift if is_twin else _door_place(rng, cell[2] - cell[0], door_m))
        doors.append(Door(x, cell[1] if is_north else cell[3], door_m, "x", (0, index + 1)))
        rooms.append(PlannedRoom(cell, uses[index], NORTH if is_north else SOUTH))
    closed = [
        (cells[-1][2], cells[-1][1], length, cells[-1][3])
        for cells in (cells_south, cells_north)
        if length - cells[-1][2] > 1e-6
    ]
    twins = (1 + len(south), 2 + len(south)) if has_twins else None
    return Plan(tuple(rooms), tuple(doors), twins, tuple(closed))


def _open_plan(rng: np.random.Generator, has_twins: bool) -> Plan | None:
    """A living room that opens widely into the kitchen; two rooms behind equal doors on its long side."""
    depth, north_depth, opening = (float(v) for v in rng.uniform([3.4, 2.9, WIDE_OPENING_M[0]], [4.6, 3.8, 2.3]))
    north = _widths(rng, 2, has_twins, 3.0, 4.2)
    length = sum(north)
    cut = length * float(rng.uniform(0.5, 0.65))
    living, kitchen = (0.0, 0.0, cut, depth), (cut, 0.0, length, depth)
    door_m = float(rng.uniform(*DOOR_WIDTHS_M))
    middle = float(rng.uniform(opening / 2 + DOOR_TO_CORNER_M, depth - opening / 2 - DOOR_TO_CORNER_M))
    doors = [Door(cut, middle, opening, "y", (0, 1))]
    shift = _door_place(rng, north[0], door_m)
    rooms = [PlannedRoom(living, "living room", SOUTH), PlannedRoom(kitchen, "kitchen", SOUTH)]
    uses = ("bedroom", "bedroom") if has_twins else ("bedroom", "study")
    for index, cell in enumerate(_side_by_side(north, depth, depth + north_depth)):
        x = cell[0] + (shift if has_twins else _door_place(rng, cell[2] - cell[0], door_m))
        if abs(x - cut) < door_m / 2 + DOOR_TO_CORNER_M:
            return None  # the door would lead into the wall between living room and kitchen
        doors.append(Door(x, depth, door_m, "x", (0 if x < cut else 1, 2 + index)))
        rooms.append(PlannedRoom(cell, uses[index], NORTH))
    return Plan(tuple(rooms), tuple(doors), (2, 3) if has_twins else None)


def _row(rng: np.random.Generator, _has_twins: bool) -> Plan:
    """Three or four rooms one behind the other, their doors in a line along the windows."""
    widths = [float(w) for w in rng.uniform(2.9, 4.4, int(rng.integers(3, 5)))]
    depth = float(rng.uniform(3.2, 4.2))
    door_m, y = float(rng.uniform(*DOOR_WIDTHS_M)), float(rng.uniform(0.9, depth - 0.9))
    cells = _side_by_side(widths, 0.0, depth)
    uses = ["kitchen", "living room", "bedroom", "study"]
    side = SOUTH if rng.random() < 0.5 else NORTH
    rooms = tuple(PlannedRoom(cell, use, side) for cell, use in zip(cells, uses, strict=False))
    doors = tuple(Door(cell[2], y, door_m, "y", (i, i + 1)) for i, cell in enumerate(cells[:-1]))
    return Plan(rooms, doors)


def _corner(rng: np.random.Generator) -> Plan:
    """A living room of two rectangles, an L; a kitchen in its corner, one or two rooms behind its long side."""
    width, depth, arm = (float(v) for v in rng.uniform([4.6, 2.9, 2.3], [5.6, 3.6, 2.9]))
    north, east = (float(v) for v in rng.uniform([2.6, 2.9], [3.4, 3.6]))
    door_m, half = float(rng.uniform(*DOOR_WIDTHS_M)), WALL_THICKNESS_M / 2
    top, right = depth + north, width + east
    rooms = [
        PlannedRoom((0.0, 0.0, width, depth), "living room", SOUTH),
        PlannedRoom((0.0, depth, arm, top), "living room", WEST, part_of=0),
        PlannedRoom((arm, depth, width, top), "kitchen", NORTH),
        PlannedRoom((width, 0.0, right, depth), "bedroom", EAST),
    ]
    doors = [
        Door(arm / 2, depth, arm - 2 * half, "x", (0, 1)),  # as wide as the arm
        Door(width, _door_place(rng, depth, door_m), door_m, "y", (0, 3)),
    ]
    if rng.random() < 0.5:
        doors.append(Door(arm + _door_place(rng, width - arm, door_m), depth, door_m, "x", (0, 2)))
    else:
        doors.append(Door(arm, depth + _door_place(rng, north, door_m), door_m, "y", (1, 2)))
    if rng.random() < 0.5:
        rooms.append(PlannedRoom((width, depth, right, top), "study", NORTH))
        doors.append(Door(width + _door_place(rng, east, door_m), depth, door_m, "x", (3, 4)))
        return Plan(tuple(rooms), tuple(doors))
    return Plan(tuple(rooms), tuple(doors), closed=((width, depth, right, top),))


def _large(rng: np.random.Generator) -> Plan:
    """Five to seven rooms on both sides of a long corridor."""
    north = _widths(rng, int(rng.integers(3, 5)), False, 2.7, 3.8)
    south = _widths(rng, int(rng.integers(2, 4)), False, 2.9, 4.2)
    south_depth, north_depth, width = (float(v) for v in rng.uniform([3.0, 2.9, 1.3], [4.0, 4.0, 1.7]))
    length = max(sum(north), sum(south))
    door_m = float(rng.uniform(*DOOR_WIDTHS_M))
    hall = (0.0, south_depth, length, south_depth + width)
    cells_south, cells_north = (
        _side_by_side(south, 0.0, south_depth),
        _side_by_side(north, hall[3], hall[3] + north_depth),
    )
    uses = ["living room", "kitchen", "study"][: len(south)] + ["bedroom", "guest room", "bedroom", "study"][
        : len(north)
    ]
    rooms = [PlannedRoom(hall, "hall", WEST if rng.random() < 0.5 else None)]
    doors: list[Door] = []
    for index, (cell, use) in enumerate(zip([*cells_south, *cells_north], uses, strict=True), start=1):
        is_north = index > len(south)
        x = cell[0] + _door_place(rng, cell[2] - cell[0], door_m)
        doors.append(Door(x, cell[1] if is_north else cell[3], door_m, "x", (0, index)))
        rooms.append(PlannedRoom(cell, use, NORTH if is_north else SOUTH))
    closed = tuple(
        (cells[-1][2], cells[-1][1], length, cells[-1][3])
        for cells in (cells_south, cells_north)
        if length - cells[-1][2] > 1e-6
    )
    return Plan(tuple(rooms), tuple(doors), closed=closed)


def _door_place(rng: np.random.Generator, length_m: float, door_m: float) -> float:
    """Middle of a door along a wall."""
    keep = door_m / 2 + DOOR_TO_CORNER_M
    return float(rng.uniform(keep, length_m - keep))
