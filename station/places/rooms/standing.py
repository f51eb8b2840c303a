"""Where each wall stands, finer than the planes that could be one: between a plane and those beside it.

Two things say where. The log odds that chose the plane say how much likelier it is than its neighbours; the landmarks
on it say where they are. Of a patterned wall the landmarks lie within a centimetre and decide, of a bare one they
belong to what stands before it, lie anywhere, and hardly count. So each says as much as it is sure: the mean of both by
their variances. Where nothing was seen of a wall, it stays on its plane, or half-way to the neighbour where that has
but one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.geometry import FloatArray
from station.places.rooms.rectangles import Rectangle
from station.places.rooms.sides import Sides
from station.places.rooms.surfaces import LINE_M, ON_M, PIECE_M, SIDES, Seen, Side, Surfaces
from station.places.rooms.wall_model import WallModel
from station.places.space.space import Cells

NORMAL_MAD = 1.4826  # of a normal distribution its standard deviation by the median of what is off its median
LEAST_VARIANCE_M2 = 1e-8  # no wall is known to a tenth of a millimetre, and no variance divides by zero


def standing_sides(rectangles: Sequence[Rectangle], surfaces: Surfaces, sides: Sides, model: WallModel) -> FloatArray:
    """(n, 4) m, x0, x1, y0, y1: where each side of each rectangle stands, less than ON_M from its plane."""
    return np.array(
        [[_stands_at(r, side, surfaces, sides, model) for side in SIDES] for r in rectangles], dtype=np.float64
    ).reshape(-1, len(SIDES))


def _stands_at(r: Rectangle, side: Side, surfaces: Surfaces, sides: Sides, model: WallModel) -> float:
    axis, plane = side[0], r.plane(side)
    at, pieces = float(surfaces.low[axis]) + LINE_M * plane, r.pieces(axis)
    is_wall = sides.is_wall[side][plane, pieces]
    by_planes = place_by_planes(sides.odds[side][:, pieces][:, is_wall], plane, model.lead)
    across = _across(surfaces.seen, side, float(surfaces.low[1 - axis]) + PIECE_M * pieces.start, is_wall) - at
    by_landmarks = place_by_landmarks(across[np.abs(across) < ON_M])
    return at + weighed((by_planes, by_landmarks))


def place_by_planes(odds: FloatArray, plane: int, lead: float) -> tuple[float, float]:
    """Mean (m, from the plane) and variance (m²) of where a wall is: on the plane or on one of its neighbours.

    Args:
        odds: (planes, pieces) of a wall.
        lead: nats for one unit of log odds: pieces beside each other do not err each by itself.
    """
    first = max(plane - 1, 0)
    near = odds[first : plane + 2].sum(axis=1)
    offset = LINE_M * (np.arange(first, first + len(near)) - plane)
    share = np.exp((near - near.max()) / lead)
    share /= share.sum()
    mean = float(share @ offset)
    return mean, float(share @ (offset - mean) ** 2)


def place_by_landmarks(across: FloatArray) -> tuple[float, float]:
    """Median (m) and variance (m²) of where landmarks (n,) say that a wall is; of none it is infinite.

    All landmarks of a wall may be off in common, as furniture before it is, so their spread counts as it is; what a
    median of few may be off besides is that of single planes.
    """
    if not len(across):
        return 0.0, np.inf
    median = float(np.median(across))
    spread = NORMAL_MAD * float(np.median(np.abs(across - median)))
    return median, spread**2 + LINE_M**2 / len(across)


def weighed(found: Sequence[tuple[float, float]]) -> float:
    """The mean of means, each with its variance; some variance is finite."""
    weight = np.array([1.0 / max(variance, LEAST_VARIANCE_M2) for _, variance in found])
    return float(weight @ np.array([mean for mean, _ in found]) / weight.sum())


def _across(seen: Seen, side: Side, begin: float, is_wall: Cells) -> FloatArray:
    """(n,) m, where across a side its landmarks are: seen from within, beside the pieces (k,) that are wall."""
    axis, sign = side
    piece = np.floor((seen.p[:, 1 - axis] - begin) / PIECE_M).astype(np.int64)
    on = (sign * seen.towards[:, axis] > 0) & (piece >= 0) & (piece < len(is_wall))
    on[on] = is_wall[piece[on]]
    return seen.p[on, axis]
