"""What lies between two rectangles: a wall with doors parts them into two rooms, nothing makes them one."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.places.rooms.lengths import THICK_M, WALL_M
from station.places.rooms.rectangles import Rectangle
from station.places.rooms.sides import DOOR_PIECES, LEAST_ODDS, PASSAGE_PIECES, Sides, gaps_of, passage_costs
from station.places.rooms.surfaces import LINE_M, PIECE_M, SIDES, Side, Surfaces
from station.places.rooms.wall_model import WallModel

LEAST_DOOR_M = 0.45  # no robot passes a narrower gap


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A gap in the wall between two rectangles."""

    a: int
    b: int
    ends: FloatArray  # (2, 2) m


@dataclass(frozen=True, slots=True, eq=False)
class Exit:
    """A gap in a wall of a rectangle beside which there is none."""

    ends: FloatArray  # (2, 2) m
    inwards: FloatArray  # (2,) of length 1, into the rectangle


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    joined: tuple[tuple[int, int], ...]  # rectangles that nothing parts
    lead: dict[tuple[int, int], float]  # nats: of that before the contrary, for rectangles side by side
    passages: tuple[Passage, ...]


def find_borders(
    rectangles: Sequence[Rectangle], edges: FloatArray, surfaces: Surfaces, sides: Sides, model: WallModel
) -> Borders:
    """How every two rectangles side by side belong together. `edges`: where their sides stand."""
    joined, passages, lead = [], [], {}
    for (a, first), (b, second), axis in _neighbours(rectangles):
        low, high = _shorter(first, second, axis)
        odds = np.zeros(high - low)
        for r, sign in ((first, -1), (second, 1)):
            own = r.pieces(axis)
            part = slice(max(own.start, low), min(own.stop, high))
            odds[part.start - low : part.stop - low] += sides.odds[axis, sign][r.plane((axis, sign)), part]
        odds_of_wall, doors = wall_with_doors(odds, model)
        lead[a, b] = abs(odds_of_wall)
        if odds_of_wall <= 0:
            joined.append((a, b))
            continue
        across = 0.5 * (edges[a, 2 * axis + 1] + edges[b, 2 * axis])
        begin, end = _shared(first, second, axis)
        for door in doors:
            door_begin, door_end = max(low + door[0], begin), min(low + door[1], end)
            if (door_end - door_begin) * PIECE_M >= LEAST_DOOR_M:
                passages.append(Passage(a, b, _line(surfaces, axis, across, door_begin, door_end)))
    return Borders(tuple(joined), lead, tuple(passages))


def find_exits(
    rectangles: Sequence[Rectangle], edges: FloatArray, surfaces: Surfaces, sides: Sides, model: WallModel
) -> tuple[Exit, ...]:
    """Doors in the walls that part rectangles from what nobody went into: in the middle of a thin wall.

    Both faces of the wall have the gap: where only the near one has it, the wall stands farther out there.

    Args:
        edges: where the sides of the rectangles stand, the wall's near face.
    """
    shared = [{side: np.zeros(sides.odds[side].shape[1], dtype=np.bool_) for side in SIDES} for _ in rectangles]
    for (a, first), (b, second), axis in _neighbours(rectangles):
        low, high = _shared(first, second, axis)
        shared[a][axis, -1][low:high] = shared[b][axis, 1][low:high] = True
    exits = []
    for a, r in enumerate(rectangles):
        for k, side in enumerate(SIDES):
            own = r.pieces(side[0])
            for begin, end in gaps_of(shared[a][side][own]):
                pieces = slice(own.start + begin, own.start + end)
                odds, behind = sides.odds[side][r.plane(side), pieces], _behind(sides.odds[side], r.plane(side), side)
                odds_of_wall, doors = wall_with_doors(odds, model)
                middle = float(edges[a, k]) - 0.5 * WALL_M * side[1]
                inwards = side[1] * np.eye(2)[side[0]]
                exits += [
                    Exit(_line(surfaces, side[0], middle, pieces.start + first, pieces.start + last), inwards)
                    for first, last in doors
                    if odds_of_wall > 0
                    and np.isfinite([odds[first:last], behind[pieces][first:last]]).all()  # nobody passed it
                    and -behind[pieces][first:last].sum() > model.door
                ]
    return tuple(exits)


def _behind(odds: FloatArray, plane: int, side: Side) -> FloatArray:
    """(pieces,) of `odds` (planes, pieces) as far behind a side on a plane as a wall is thick; none out of the grid."""
    k = plane - side[1] * round(THICK_M / LINE_M)
    return odds[k] if 0 <= k < len(odds) else np.zeros(odds.shape[1])


def wall_with_doors(odds: FloatArray, model: WallModel) -> tuple[float, list[tuple[int, int]]]:
    """Nats for a wall against nothing at all, and where its doors begin and end: the likeliest of all ways.

    Between two doors is at least as much wall as a door is wide: a cupboard in an opening does not make two of it.

    Args:
        odds: (pieces,) for a wall, minus infinity where the body passed.
    """
    wall = np.concatenate([[0.0], np.cumsum(np.maximum(odds, LEAST_ODDS))])  # all that is before a piece
    # Of a wall up to a piece, less all of it: the doors that it has, the last of which may end so late.
    best: list[tuple[float, list[tuple[int, int]]]] = []
    for end in range(len(wall)):
        found = best[-1] if best else (0.0, [])
        for pieces, cost in zip(PASSAGE_PIECES.tolist(), passage_costs(model).tolist(), strict=True):
            if pieces <= end:
                before = best[max(end - pieces - DOOR_PIECES[0], 0)]
                gained = before[0] - float(wall[end] - wall[end - pieces]) - cost
                if gained > found[0]:
                    found = gained, [*before[1], (end - pieces, end)]
        best.append(found)
    return float(wall[-1]) + best[-1][0], best[-1][1]


def walls_of(
    rectangles: Sequence[Rectangle],
    edges: FloatArray,
    surfaces: Surfaces,
    sides: Sides,
    joined: Collection[tuple[int, int]],
) -> FloatArray:
    """(W, 2, 2) m, the parts of all sides that are wall, but for those between two that are one room.

    Args:
        edges: where their sides stand.
        joined: pairs of `Borders`.
    """
    is_wall = [[sides.is_wall[side][r.plane(side), r.pieces(side[0])].copy() for side in SIDES] for r in rectangles]
    for (a, first), (b, second), axis in _neighbours(rectangles):
        if (a, b) in joined:
            low, high = _shared(first, second, axis)
            for number, r, sign in ((a, first, -1), (b, second, 1)):
                begin = r.pieces(axis).start
                is_wall[number][SIDES.index((axis, sign))][low - begin : high - begin] = False
    segments = [
        _line(surfaces, side[0], across, r.pieces(side[0]).start + begin, r.pieces(side[0]).start + end)
        for r, its_edges, its_walls in zip(rectangles, edges, is_wall, strict=True)
        for side, across, walls in zip(SIDES, its_edges, its_walls, strict=True)
        for begin, end in gaps_of(~walls)
    ]
    return np.array(segments).reshape(-1, 2, 2)


def _line(surfaces: Surfaces, axis: int, across: float, begin: int, end: int) -> FloatArray:
    """(2, 2) m, from one piece to another of a plane across an axis."""
    along = surfaces.low[1 - axis] + PIECE_M * np.array([begin, end])
    ends = np.column_stack([np.full(2, across), along])
    return ends if axis == 0 else ends[:, ::-1]


def _neighbours(
    rectangles: Sequence[Rectangle],
) -> Iterator[tuple[tuple[int, Rectangle], tuple[int, Rectangle], int]]:
    """Pairs that stand side by side across an axis, the lower one first."""
    thick = round(THICK_M / LINE_M)
    for one, other in itertools.permutations(enumerate(rectangles), 2):
        for axis in (0, 1):
            low, high = _shared(one[1], other[1], axis)
            if abs(other[1].plane((axis, 1)) - one[1].plane((axis, -1))) <= thick and (high - low) * PIECE_M > THICK_M:
                yield one, other, axis


def _shorter(a: Rectangle, b: Rectangle, axis: int) -> tuple[int, int]:
    """The pieces of the shorter one of their sides at a border across an axis: an arm of an L has none of wall."""
    mine, its = a.pieces(axis), b.pieces(axis)
    least = mine if mine.stop - mine.start <= its.stop - its.start else its
    return least.start, least.stop


def _shared(a: Rectangle, b: Rectangle, axis: int) -> tuple[int, int]:
    """The pieces that both have of a border across an axis."""
    mine, its = a.pieces(axis), b.pieces(axis)
    return max(mine.start, its.start), min(mine.stop, its.stop)


def rectangles_at(edges: FloatArray, p: FloatArray) -> IntArray:
    """(n,) number of the rectangle (of `edges`) around each point (n, 2) m, -1 for none."""
    found = np.full(len(p), -1, dtype=np.int64)
    for number, (x0, x1, y0, y1) in enumerate(edges):
        inside = (p[:, 0] > x0) & (p[:, 0] < x1) & (p[:, 1] > y0) & (p[:, 1] < y1)
        found[inside & (found < 0)] = number
    return found
