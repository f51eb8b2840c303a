"""What landmarks, sights and the path say of every upright plane that a wall could be: along x, and along y.

A plane is a line on the ground, cut into short pieces. Of each piece we count the landmarks on it that were seen from
one side, and the sights that pass through it; and whether any sight reached the space before it, without which neither
count says anything. A wall shows landmarks, or nothing, and no sight passes; a sight that ends on a landmark passes
through everything before it, at whatever height: over a bed, not over a wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.geometry import FloatArray, IntArray, yaw_rotation
from station.model.navigation import Navigation
from station.places.making.scale import units_per_metre
from station.places.rooms.evidence import above_floor
from station.places.rooms.lengths import SKIRTING_M, WALL_M
from station.places.space.carving import FARTHEST_M, MAX_CELLS
from station.places.space.observed import Observed
from station.places.space.sight import SECTORS
from station.places.space.space import Cells

Side = tuple[int, int]  # the axis that a plane stands across, and the direction along it in which the room lies: 1, -1
SIDES: tuple[Side, ...] = ((0, 1), (0, -1), (1, 1), (1, -1))
LINE_M = 0.5 * WALL_M  # between planes
PIECE_M = WALL_M  # of a plane
ON_M = 1.5 * LINE_M  # a landmark so near a plane is on it
SHORT_OF = 0.97, 0.05  # a sight ends this share of its way, and so many metres, before its landmark: depths err
BEFORE_M = (0.2, 0.3, 0.4)  # a plane: the sights that come so near look at it
COUNTS = (0, 1, 2, 4)  # least of each class, of landmarks and of crossings; more do not say more
LOOKED = (0, 1, 4)  # ... of the sights that look at a piece
CLASSES = len(COUNTS) * len(COUNTS) * len(LOOKED)
UNSEEN = 0  # the class of a piece of which nobody saw anything
AREA_COUNTS = (0, 1, 4, 10, 30)
DRIVEN = len(AREA_COUNTS)
AREA_CLASSES = len(AREA_COUNTS) + 1


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a navigation saw, as seen from above. Lengths are metres on the ground."""

    p: FloatArray  # (n, 2) landmarks, but for those on the floor
    towards: FloatArray  # (n, 2) to where each was seen from
    sights: FloatArray  # (k, 4) from x, y to x, y: nothing stood between
    path: FloatArray  # (m, 2) of the body

    @classmethod
    def of(cls, navigation: Navigation, R_ground_map: FloatArray) -> Seen:
        unit = units_per_metre(navigation)
        seen = Observed.of(navigation)
        p = seen.p_map @ R_ground_map.T / unit
        eyes = seen.eye_map @ R_ground_map.T / unit
        path = (navigation.trajectory.T_world_body[:, :3, 3] @ R_ground_map.T / unit)[:, :2]
        path = path[np.isfinite(path).all(axis=1)]
        path = path if len(path) else eyes[np.isfinite(eyes).all(axis=1), :2]
        stands = np.isfinite(p).all(axis=1)
        if stands.any():
            stands &= above_floor(p[:, 2]) > SKIRTING_M
        towards = _towards_observers(seen, p, eyes)
        return cls(p[stands, :2], towards[stands], _sights(seen, p, eyes), path)

    def turned(self, yaw: float) -> Seen:
        """In other axes: rad."""
        R = yaw_rotation(yaw)[:2, :2].T
        sights = np.column_stack([self.sights[:, :2] @ R, self.sights[:, 2:] @ R])
        return Seen(self.p @ R, self.towards @ R, sights, self.path @ R)


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Planes at `low` + k * LINE_M, cut into pieces at `low` + j * PIECE_M. Lengths are metres on the ground."""

    seen: Seen
    low: FloatArray  # (2,)
    classes: dict[Side, npt.NDArray[np.intp]]  # (planes, pieces) of the counts, for a wall seen from that side
    area_classes: npt.NDArray[np.intp]  # (X, Y) of cells as wide as a piece: how many sights passed, or the body
    driven: Cells  # (X, Y) by the body
    passed: dict[int, Cells]  # for planes across each axis (planes, pieces): the body was there, so no wall is
    feet: dict[Side, npt.NDArray[np.intp]] | None = None  # (planes, pieces) as `feet.py` says; None: nobody looked


def find_surfaces(seen: Seen) -> Surfaces | None:
    """Evidence of one navigation; None where it saw nothing, or drove through a whole quarter."""
    grid = _Grid.around(seen)
    if grid is None:
        return None
    driven = grid.cells(seen.path)
    area = np.where(driven, DRIVEN, _count_class(grid.passed(seen.sights), AREA_COUNTS))
    passed = {0: _within(driven), 1: _within(driven.T)}
    return Surfaces(seen, grid.low, _piece_classes(seen, grid), area, driven, passed)


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Of `Surfaces` what is of planes alone."""

    low: FloatArray
    classes: dict[Side, npt.NDArray[np.intp]]


def find_pieces(seen: Seen) -> Pieces | None:
    """None where `find_surfaces` gives none."""
    grid = _Grid.around(seen)
    return None if grid is None else Pieces(grid.low, _piece_classes(seen, grid))


def _piece_classes(seen: Seen, grid: _Grid) -> dict[Side, npt.NDArray[np.intp]]:
    crossed = [grid.crossed(seen.sights, axis) + COUNTS[-1] * grid.driven_through(seen.path, axis) for axis in (0, 1)]
    classes = {}
    for axis, sign in SIDES:
        on = grid.landmarks_on(seen.p[sign * seen.towards[:, axis] > 0], axis)
        classes[axis, sign] = _class_of(on, crossed[axis], _looked_at(crossed[axis], sign))
    return classes


def _within(driven: Cells) -> Cells:
    """(planes, pieces) those across the first axis of cells (X, Y) with the body on both their faces."""
    middles = np.zeros((2 * len(driven) + 1, driven.shape[1]), dtype=np.bool_)
    middles[1::2] = driven
    middles[2:-1:2] = driven[:-1] & driven[1:]
    return middles


def _class_of(on: FloatArray, crossed: FloatArray, looked: FloatArray) -> npt.NDArray[np.intp]:
    counts = _count_class(on, COUNTS) * len(COUNTS) + _count_class(crossed, COUNTS)
    return np.asarray(counts * len(LOOKED) + _count_class(looked, LOOKED))


def _count_class(count: FloatArray, least: tuple[int, ...]) -> npt.NDArray[np.intp]:
    return np.searchsorted(np.array(least), np.round(count), side="right") - 1


def _looked_at(crossed: FloatArray, sign: int) -> FloatArray:
    steps = [round(distance / LINE_M) for distance in BEFORE_M]
    return np.asarray(np.max([np.roll(crossed, -sign * step, axis=0) for step in steps], axis=0))


def _sights(seen: Observed, p: FloatArray, eyes: FloatArray) -> FloatArray:
    """(n, 4) from x, y to x, y: one for each sector of each keyframe, to its second farthest landmark.

    Of several the farthest may be false. Nearer ones add nothing but the same way again.
    """
    keyframe, landmark = seen.eye, seen.point
    rows = np.flatnonzero(np.isfinite(p[landmark]).all(axis=1) & np.isfinite(eyes[keyframe]).all(axis=1))
    keyframe, landmark = keyframe[rows], landmark[rows]
    d = p[landmark, :2] - eyes[keyframe, :2]
    far = np.hypot(d[:, 0], d[:, 1])
    turn = np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) % 1.0
    of = keyframe * SECTORS + np.floor(turn * SECTORS).astype(np.int64) % SECTORS
    order = np.lexsort((landmark, -far, of))
    _, begin, count = np.unique(of[order], return_index=True, return_counts=True)
    chosen = order[begin + np.minimum(count - 1, 1)]
    reach = np.minimum(SHORT_OF[0] * far[chosen], FARTHEST_M) - SHORT_OF[1]
    share = np.maximum(reach, 0.0) / np.maximum(far[chosen], 1e-9)
    eye = eyes[keyframe[chosen], :2]
    return np.column_stack([eye, eye + d[chosen] * share[:, None]])


def _towards_observers(seen: Observed, p: FloatArray, eyes: FloatArray) -> FloatArray:
    """(n, 2) the mean direction from each landmark to where it was seen from."""
    d = eyes[seen.eye, :2] - p[seen.point, :2]
    d /= np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-9)[:, None]
    finite = np.isfinite(d).all(axis=1)
    total = np.zeros((len(p), 2))
    np.add.at(total, seen.point[finite], d[finite])
    return total


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Counts things by plane and piece, or by cell."""

    low: FloatArray
    shape: tuple[int, int]  # cells

    @classmethod
    def around(cls, seen: Seen) -> _Grid | None:
        """None where nothing was seen, or the drive is too long for one flat."""
        if not len(seen.path) or not len(seen.sights):
            return None
        low = np.floor((seen.path.min(axis=0) - FARTHEST_M) / PIECE_M) * PIECE_M
        shape = np.ceil((seen.path.max(axis=0) + FARTHEST_M - low) / PIECE_M).astype(int)
        return None if np.prod(shape.astype(float)) > MAX_CELLS else cls(low, (int(shape[0]), int(shape[1])))

    def landmarks_on(self, p: FloatArray, axis: int) -> FloatArray:
        """(planes, pieces) of points (n, 2), within ON_M of a plane."""
        plane = np.round((p[:, axis] - self.low[axis]) / LINE_M).astype(np.int64)
        piece = np.floor((p[:, 1 - axis] - self.low[1 - axis]) / PIECE_M).astype(np.int64)
        return np.asarray(3 * ndimage.uniform_filter1d(self._counted(axis, plane, piece), 3, axis=0, mode="constant"))

    def crossed(self, lines: FloatArray, axis: int) -> FloatArray:
        """(planes, pieces) how many of the lines (n, 4) pass through."""
        begin, end = lines[:, axis], lines[:, 2 + axis]
        other, other_end = lines[:, 1 - axis], lines[:, 3 - axis]
        first = np.ceil((np.minimum(begin, end) - self.low[axis]) / LINE_M).astype(np.int64)
        last = np.floor((np.maximum(begin, end) - self.low[axis]) / LINE_M).astype(np.int64)
        of, step = _repeated(np.maximum(last - first + 1, 0))
        plane = first[of] + step
        run = end - begin
        share = (self.low[axis] + plane * LINE_M - begin[of]) / np.where(run == 0.0, 1.0, run)[of]
        at = other[of] + share * (other_end - other)[of]
        return self._counted(axis, plane, np.floor((at - self.low[1 - axis]) / PIECE_M).astype(np.int64))

    def driven_through(self, path: FloatArray, axis: int) -> Cells:
        """(planes, pieces) where the body passed, as wide as it is at least: a piece to each side."""
        steps = np.column_stack([path[:-1], path[1:]])
        steps = steps[np.hypot(*(steps[:, 2:] - steps[:, :2]).T) < BODY_LEAP_M]
        through = self.crossed(steps, axis) > 0
        return np.asarray(ndimage.maximum_filter1d(through, 3, axis=1))

    def passed(self, lines: FloatArray) -> FloatArray:
        """(X, Y) how often lines (n, 4) pass through a cell or one beside it."""
        d = lines[:, 2:] - lines[:, :2]
        count = np.maximum(np.hypot(d[:, 0], d[:, 1]) / LINE_M, 1.0).astype(np.int64)
        of, step = _repeated(count)
        p = lines[of, :2] + ((step + 0.5) / count[of])[:, None] * d[of]
        i, j = np.floor((p - self.low) / PIECE_M).astype(np.int64).T
        return np.round(9 * ndimage.uniform_filter(_counts(i, j, self.shape), 3, mode="constant"))

    def cells(self, p: FloatArray) -> Cells:
        """(X, Y) those with a point (n, 2) in them or beside them."""
        found = np.zeros(self.shape, dtype=np.bool_)
        found[tuple(np.floor((p - self.low) / PIECE_M).astype(np.int64).T)] = True
        return np.asarray(ndimage.binary_dilation(found, np.ones((3, 3))), dtype=np.bool_)

    def _counted(self, axis: int, plane: IntArray, piece: IntArray) -> FloatArray:
        return _counts(plane, piece, (2 * self.shape[axis] + 1, self.shape[1 - axis]))


BODY_LEAP_M = 0.5  # between two poses: nobody drove there


def _counts(i: IntArray, j: IntArray, shape: tuple[int, int]) -> FloatArray:
    """(X, Y) how often each pair of indices (n,) occurs; those outside are left out."""
    inside = (i >= 0) & (j >= 0) & (i < shape[0]) & (j < shape[1])
    at = i[inside] * shape[1] + j[inside]
    return np.bincount(at, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)


def _repeated(count: IntArray) -> tuple[IntArray, IntArray]:
    """Index k `count[k]` times, and 0, 1, ... for each of them."""
    of = np.repeat(np.arange(len(count)), count)
    return of, np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
