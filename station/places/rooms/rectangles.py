"""Rooms as rectangles: the set of them, none over another, that explains walls and free space best.

Every choice of four planes is a rectangle, with a score: the log odds of its four sides, doors and all, and of the
space within. Which set has the largest sum is set packing. Its linear relaxation is solved exactly over all rectangles
by column generation (Ford and Fulkerson, 1958): the prices of the ground say which rectangle is missing. In all flats
that we looked at its solution was whole already; where it is not, the integer programme over its rectangles decides.
A room of another shape is several rectangles: what lies open between them joins them (`borders.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from shared.geometry import FloatArray, IntArray
from station.places.rooms.lengths import WALL_M
from station.places.rooms.sides import Sides, best_runs
from station.places.rooms.surfaces import LINE_M, PIECE_M, SIDES, Side, Surfaces
from station.places.rooms.wall_model import WallModel
from station.places.space.space import Cells

MOST_PLANES = 20  # for each of the four sides: the strongest
MOST_OPEN = 8  # ... and, for open ones, the strongest of the opposite side
LEAST_M = 0.9  # a robot drives into nothing narrower
PRICE_M = PIECE_M  # between the points of the ground that have a price: what lies between two may be two rooms'
COLUMNS = 12  # new rectangles of a round
ROUNDS = 60
SAME = 0.7  # overlap (IoU) from which two new rectangles are nearly one


@dataclass(frozen=True, slots=True, order=True)
class Rectangle:
    """Four planes: the numbers of those that bound it along x, and along y."""

    x0: int
    x1: int
    y0: int
    y1: int

    def span(self, axis: int) -> tuple[int, int]:
        return (self.x0, self.x1) if axis == 0 else (self.y0, self.y1)

    def plane(self, side: Side) -> int:
        """The plane on which this side of it stands."""
        low, high = self.span(side[0])
        return low if side[1] > 0 else high

    def pieces(self, axis: int) -> slice:
        """Of a side across `axis`."""
        low, high = self.span(1 - axis)
        return slice(low // 2, high // 2)

    def overlap(self, other: Rectangle) -> float:
        """Intersection over union."""
        width = min(self.x1, other.x1) - max(self.x0, other.x0)
        height = min(self.y1, other.y1) - max(self.y0, other.y0)
        both = max(width, 0) * max(height, 0)
        return both / (self._area() + other._area() - both)

    def _area(self) -> int:
        return (self.x1 - self.x0) * (self.y1 - self.y0)


@dataclass(frozen=True, slots=True)
class Packed:
    """The best set of rectangles."""

    rectangles: tuple[Rectangle, ...]
    lead: tuple[float, ...]  # nats: of this set before the best one without this rectangle or one nearly the same


def find_rectangles(surfaces: Surfaces, sides: Sides, model: WallModel) -> Packed:
    """The best set of rectangles that the body entered."""
    walls = {side: strongest_planes(sides.odds[side], MOST_PLANES) for side in SIDES}
    # An open side shows no wall: it begins where another rectangle's wall ends.
    opposite = {(axis, sign): strongest_planes(sides.odds[axis, -sign], MOST_OPEN) for axis, sign in SIDES}
    planes = [np.union1d(walls[side], opposite[side]) for side in SIDES]
    if not all(len(found) for found in planes):
        return Packed((), ())
    return _packed(_Choices(planes, _scores(surfaces, sides, model, planes)), surfaces)


def strongest_planes(odds: FloatArray, most: int) -> IntArray:
    """Numbers of the planes with the likeliest walls.

    Of planes nearer to each other than a wall is thick each stretch of landmarks counts on the best one only.
    """
    left = odds.copy()
    reach = round(WALL_M / LINE_M)
    strength, begin, end = best_runs(left)
    found: set[int] = set()
    while len(found) < most and strength.max() > 0:
        k = int(strength.argmax())
        found.add(k)
        left[max(k - reach, 0) : k + reach + 1, begin[k] : end[k]] = -np.inf
        near = slice(max(k - 2 * reach, 0), k + 2 * reach + 1)
        strength[near], begin[near], end[near] = best_runs(left[near])
    return np.array(sorted(found), dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class _Choices:
    """All rectangles: `score[i, j, k, l]` of x0, x1, y0, y1 by their place in the four lists of planes."""

    planes: list[IntArray]
    score: FloatArray

    def summed(self, cumulated: FloatArray, planes: list[IntArray] | None = None) -> FloatArray:
        """The sum within each rectangle of what is cumulated along both axes."""
        x0, x1, y0, y1 = self.planes if planes is None else planes
        return _within(cumulated, x0, x1, y0, y1)

    def rectangle(self, flat: int) -> Rectangle:
        index = np.unravel_index(flat, self.score.shape)
        return Rectangle(*(int(planes[k]) for planes, k in zip(self.planes, index, strict=True)))


def _within(cumulated: FloatArray, x0: IntArray, x1: IntArray, y0: IntArray, y1: IntArray) -> FloatArray:
    a, b = x0[:, None], x1[:, None]
    high, low = cumulated[b, y1][None, :, None, :], cumulated[a, y0][:, None, :, None]
    return np.asarray(high - cumulated[a, y1][:, None, None, :] - cumulated[b, y0][None, :, :, None] + low)


def _scores(surfaces: Surfaces, sides: Sides, model: WallModel, planes: list[IntArray]) -> FloatArray:
    x0, x1, y0, y1 = planes
    left, right, front, back = (sides.total[side][found] for side, found in zip(SIDES, planes, strict=True))
    along_y = [total[:, y1 // 2][:, None] - total[:, y0 // 2][:, :, None] for total in (left, right)]  # (x, y0, y1)
    along_x = [total[:, x1 // 2][:, None] - total[:, x0 // 2][:, :, None] for total in (front, back)]  # (y, x0, x1)
    score = along_y[0][:, None] + along_y[1][None]
    score = score + np.moveaxis(along_x[0], 0, -1)[:, :, :, None] + np.moveaxis(along_x[1], 0, -1)[:, :, None, :]
    score += _within(sides.area, x0, x1, y0, y1) - model.room
    least = LEAST_M / LINE_M
    score[(x1 - x0[:, None]) < least] = -np.inf
    score[:, :, (y1 - y0[:, None]) < least] = -np.inf
    driven = np.zeros((surfaces.driven.shape[0] + 1, surfaces.driven.shape[1] + 1))
    driven[1:, 1:] = surfaces.driven.cumsum(axis=0).cumsum(axis=1)
    score[_within(driven, x0 // 2, x1 // 2, y0 // 2, y1 // 2) * PIECE_M**2 < LEAST_DRIVEN_M2] = -np.inf
    return np.asarray(score)


LEAST_DRIVEN_M2 = 3 * PIECE_M * 1.0  # a metre of the way, three cells wide: who only touches a part has not entered it


def _packed(choices: _Choices, surfaces: Surfaces) -> Packed:
    step, beside = round(PRICE_M / LINE_M), round(WALL_M / LINE_M)
    shape = tuple(2 * n // step + 1 for n in surfaces.driven.shape)
    # The priced points in a rectangle; what lies as near its sides as a wall is thick has none.
    first = [-(-(choices.planes[k] + beside) // step) for k in (0, 2)]
    last = [np.clip((choices.planes[k] - beside) // step + 1, 0, shape[k // 2]) for k in (1, 3)]
    index = [first[0], last[0], first[1], last[1]]
    price = np.zeros(shape)
    columns: list[Rectangle] = []
    score: list[float] = []
    covers: list[np.ndarray] = []
    keys = np.random.default_rng(0)
    signature = np.zeros(shape, dtype=np.int64)  # the same random number where the same columns are
    packing = _Packing(np.zeros((0, 0)), np.zeros(0, np.intp), np.zeros(0))
    for _ in range(ROUNDS):
        cumulated = np.zeros((shape[0] + 1, shape[1] + 1))
        cumulated[1:, 1:] = price.cumsum(axis=0).cumsum(axis=1)
        gain = choices.score - choices.summed(cumulated, index)
        new = _most_gainful(choices, gain, set(columns))
        if not new:
            break
        for flat in new:
            r = choices.rectangle(flat)
            columns.append(r)
            score.append(float(choices.score.ravel()[flat]))
            cover = np.zeros(shape, np.bool_)
            cover[
                -(-(r.x0 + beside) // step) : (r.x1 - beside) // step + 1,
                -(-(r.y0 + beside) // step) : (r.y1 - beside) // step + 1,
            ] = True
            covers.append(cover.ravel())
            signature[cover] ^= keys.integers(np.iinfo(np.int64).max)
        packing = _Packing.of(covers, signature.ravel(), np.array(score))
        price = packing.prices().reshape(shape)
    chosen = sorted(packing.chosen(), key=lambda k: columns[k])
    best = sum(score[k] for k in chosen)
    lead = []
    for k in chosen:
        others = np.array([columns[k].overlap(r) <= SAME for r in columns])
        lead.append(best - sum(score[other] for other in packing.chosen(others)))
    return Packed(tuple(columns[k] for k in chosen), tuple(lead))


def _most_gainful(choices: _Choices, gain: FloatArray, known: set[Rectangle]) -> list[int]:
    """Rectangles that the packing lacks most, no two of them nearly one."""
    flat = gain.ravel()
    candidates = np.flatnonzero(flat > 1e-6)
    if len(candidates) > 400:
        candidates = candidates[np.argpartition(-flat[candidates], 400)[:400]]
    found: list[int] = []
    rectangles: list[Rectangle] = []
    for k in candidates[np.lexsort((candidates, -flat[candidates]))].tolist():
        r = choices.rectangle(k)
        if r not in known and all(r.overlap(other) <= SAME for other in rectangles):
            found.append(k)
            rectangles.append(r)
        if len(found) == COLUMNS:
            break
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Packing:
    """At most one rectangle over each point: maximise the sum of scores."""

    covers: np.ndarray  # (constraints, columns)
    constraint: np.ndarray  # (points,) number of each point's, -1 without
    score: FloatArray

    @classmethod
    def of(cls, covers: list[np.ndarray], signature: IntArray, score: FloatArray) -> _Packing:
        """`covers` (points,) of each column. Points of one signature (points,) lie in the same: one constraint."""
        _, first, number = np.unique(signature, return_index=True, return_inverse=True)
        return cls(np.stack([cover[first] for cover in covers], axis=1).astype(np.float64), number, score)

    def prices(self) -> FloatArray:
        """(points,) of the ground: the dual of the linear relaxation."""
        solved = linprog(
            -self.score,
            A_ub=sparse.csr_matrix(self.covers),
            b_ub=np.ones(len(self.covers)),
            bounds=(0, None),  # the constraints bound them; a bound of its own would take a part of the price
            method="highs-ds",
        )
        dual = -solved.ineqlin.marginals / np.bincount(self.constraint, minlength=len(self.covers))
        return np.asarray(dual[self.constraint])

    def chosen(self, allowed: Cells | None = None) -> list[int]:
        """Columns of the best set, of all or of those allowed (columns,)."""
        if not len(self.score):
            return []
        solved = milp(
            -self.score,
            constraints=LinearConstraint(sparse.csr_matrix(self.covers), -np.inf, 1.0),
            integrality=np.ones(len(self.score)),
            bounds=Bounds(0, np.ones(len(self.score)) if allowed is None else allowed.astype(np.float64)),
        )
        return [] if solved.x is None else np.flatnonzero(solved.x > 0.5).tolist()
