"""What lies between two rectangles: a wall with doors parts them into two rooms, nothing makes them one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.places.rooms.rectangles import Rectangle
from station.places.rooms.sides import Sides, likeliest_walls, score_of
from station.places.rooms.surfaces import LINE_M, PIECE_M, Surfaces
from station.places.rooms.wall_model import WallModel
from station.places.space.space import Cells

THICK_M = 0.35  # a wall at most, and errors of both its faces


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A gap in the wall between two rectangles."""

    a: int
    b: int
    ends: FloatArray  # (2, 2) m


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    joined: tuple[tuple[int, int], ...]  # rectangles that nothing parts
    passages: tuple[Passage, ...]


def find_borders(rectangles: Sequence[Rectangle], surfaces: Surfaces, sides: Sides, model: WallModel) -> Borders:
    """How every two rectangles side by side belong together."""
    joined, passages = [], []
    for (a, first), (b, second), axis in _neighbours(rectangles):
        low, high = _shared(first, second, axis)
        at = first.plane((axis, -1)), second.plane((axis, 1))
        odds = (sides.odds[axis, -1][at[0], low:high] + sides.odds[axis, 1][at[1], low:high])[None]
        is_wall = likeliest_walls(odds, model)
        if float(score_of(is_wall, odds, model).sum()) < 0 or not is_wall.any():
            joined.append((a, b))
        across = surfaces.low[axis] + LINE_M * 0.5 * (at[0] + at[1])
        for begin, end in _gaps(is_wall[0]):
            along = surfaces.low[1 - axis] + PIECE_M * np.array([low + begin, low + end])
            ends = np.column_stack([np.full(2, across), along])
            passages.append(Passage(a, b, ends if axis == 0 else ends[:, ::-1]))
    return Borders(tuple(joined), tuple(passages))


def walls_of(rectangles: Sequence[Rectangle], surfaces: Surfaces, sides: Sides) -> FloatArray:
    """(W, 2, 2) m, the parts of all sides that are wall."""
    segments = []
    for r in rectangles:
        for side, is_wall in sides.is_wall.items():
            axis, pieces, plane = side[0], r.pieces(side[0]), r.plane(side)
            across = surfaces.low[axis] + LINE_M * plane
            for begin, end in _gaps(~is_wall[plane, pieces]):
                along = surfaces.low[1 - axis] + PIECE_M * np.array([pieces.start + begin, pieces.start + end])
                ends = np.column_stack([np.full(2, across), along])
                segments.append(ends if axis == 0 else ends[:, ::-1])
    return np.array(segments).reshape(-1, 2, 2)


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


def _shared(a: Rectangle, b: Rectangle, axis: int) -> tuple[int, int]:
    """The pieces that both have of a border across an axis."""
    mine, its = a.pieces(axis), b.pieces(axis)
    return max(mine.start, its.start), min(mine.stop, its.stop)


def _gaps(is_wall: Cells) -> list[tuple[int, int]]:
    """Begin and end of each stretch without wall."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], is_wall, [True]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def rectangles_at(rectangles: Sequence[Rectangle], surfaces: Surfaces, p: FloatArray) -> IntArray:
    """(n,) number of the rectangle around each point (n, 2) m, -1 for none."""
    at = (p - surfaces.low) / LINE_M
    found = np.full(len(p), -1, dtype=np.int64)
    for number, r in enumerate(rectangles):
        inside = (at[:, 0] > r.x0) & (at[:, 0] < r.x1) & (at[:, 1] > r.y0) & (at[:, 1] < r.y1)
        found[inside & (found < 0)] = number
    return found
