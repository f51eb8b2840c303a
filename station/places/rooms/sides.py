"""Where a plane is a wall and where it has a gap, a door or an opening: the likeliest sequence of both (Viterbi)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.places.rooms.surfaces import DOOR_PIECES, SIDES, Side, Surfaces
from station.places.rooms.wall_model import WallModel
from station.places.space.space import Cells


@dataclass(frozen=True, slots=True, eq=False)
class Doors:
    """What a door costs that begins with a piece of a plane: of a building there are too many to keep all costs."""

    frames: npt.NDArray[np.uint8]  # (planes, pieces, DOOR_PIECES) classes, as in `Surfaces`
    cost: FloatArray  # (FRAME_CLASSES,)

    def of(self, *index: IntArray | slice | int) -> FloatArray:
        """Costs at an index of `frames`."""
        return self.cost[self.frames[index]]

    def least(self) -> FloatArray:
        """(planes,) of any door in each plane."""
        least = np.full(len(self.frames), np.inf)
        for number, cost in enumerate(self.cost):
            least = np.where((self.frames == number).any(axis=(1, 2)), np.minimum(least, cost), least)
        return least


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """Log odds of walls on the planes of `Surfaces`, seen from either side."""

    odds: dict[Side, FloatArray]  # (planes, pieces) of a wall
    doors: dict[int, Doors]  # for planes across each axis
    is_wall: dict[Side, Cells]  # (planes, pieces) the likeliest labels of whole planes
    total: dict[Side, FloatArray]  # (planes, pieces + 1) cumulated score of these labels
    area: FloatArray  # (2 X + 1, 2 Y + 1) cumulated score of the cells below a pair of planes


def weigh_sides(surfaces: Surfaces, model: WallModel) -> Sides:
    """Odds of all planes at once."""
    table = np.array(model.wall)
    odds = {side: np.where(surfaces.passed[side[0]], -np.inf, table[surfaces.classes[side]]) for side in SIDES}
    cost = model.door - model.frame_weight * np.array(model.frame)
    doors = {axis: Doors(frames, cost) for axis, frames in surfaces.frames.items()}
    is_wall, total = {}, {}
    for side in SIDES:
        is_wall[side] = likeliest_walls(odds[side], doors[side[0]], model)
        score = score_of(is_wall[side], odds[side], doors[side[0]], model)
        total[side] = np.concatenate([np.zeros((len(score), 1)), np.cumsum(score, axis=1)], axis=1)
    cells = model.area_weight * np.array(model.area)[surfaces.area_classes]
    quarters = np.repeat(np.repeat(cells, 2, axis=0), 2, axis=1) / 4  # planes lie in the middle of cells, too
    area = np.zeros((quarters.shape[0] + 1, quarters.shape[1] + 1))
    area[1:, 1:] = quarters.cumsum(axis=0).cumsum(axis=1)
    return Sides(odds, doors, is_wall, total, area)


def likeliest_walls(odds: FloatArray, doors: Doors, model: WallModel) -> Cells:
    """(planes, pieces) the best sequence of wall and gaps (Viterbi); a door may be a gap of the usual widths."""
    n, count = odds.shape
    wall = np.full((n, count + 1), -np.inf)  # best score so far that ends with a wall before piece j
    gap = np.full((n, count + 1), -np.inf)
    wall[:, 0], gap[:, 0] = 0.0, -model.gap
    came = np.zeros((n, count + 1), dtype=np.int64)  # how many pieces of gap lie before the wall: 0, a door, or -1
    opened = np.zeros((n, count + 1), dtype=np.bool_)
    for j in range(1, count + 1):
        begin = [max(j - 1 - d, 0) for d in DOOR_PIECES]
        behind_doors = (wall[:, k] - doors.of(slice(None), k, width) for width, k in enumerate(begin))
        before = np.stack([wall[:, j - 1], gap[:, j - 1], *behind_doors])
        before[2:][np.array(DOOR_PIECES) > j - 1] = -np.inf
        best = before.argmax(axis=0)
        came[:, j] = np.array([0, -1, *DOOR_PIECES])[best]
        wall[:, j] = before[best, np.arange(n)] + odds[:, j - 1]
        opened[:, j] = wall[:, j - 1] - model.gap > gap[:, j - 1]
        gap[:, j] = np.maximum(wall[:, j - 1] - model.gap, gap[:, j - 1]) - model.gap_piece
    return _traced(wall[:, -1] >= gap[:, -1], came, opened)


def _traced(ends_with_wall: Cells, came: IntArray, opened: Cells) -> Cells:
    """Labels (planes, pieces) from how each was reached."""
    count = came.shape[1] - 1
    is_wall = np.zeros((len(came), count), dtype=np.bool_)
    here, skip = ends_with_wall.copy(), np.zeros(len(came), dtype=np.int64)  # pieces of a door still to pass
    for j in range(count, 0, -1):
        passing = skip > 0
        is_wall[:, j - 1] = here & ~passing
        skip[passing] -= 1
        of_wall, of_gap = here & ~passing, ~here & ~passing
        skip[of_wall] = np.maximum(came[of_wall, j], 0)
        here[of_wall] = came[of_wall, j] >= 0
        here[of_gap] = opened[of_gap, j]
    return is_wall


def score_of(is_wall: Cells, odds: FloatArray, doors: Doors, model: WallModel) -> FloatArray:
    """(planes, pieces) what labels gain or cost; all pieces of a gap bear its cost, also for sides that end in it."""
    edges = np.diff(np.pad(~is_wall, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, begin), (_, end) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    share = gap_costs(row, begin, end, doors, model) / (end - begin)
    steps = np.zeros(edges.shape)
    steps[row, begin] = share
    steps[row, end] = -share
    return np.where(is_wall, odds, -steps.cumsum(axis=1)[:, :-1])


def gap_costs(plane: IntArray, begin: IntArray, end: IntArray, doors: Doors, model: WallModel) -> FloatArray:
    """(n,) of gaps in planes from one piece to another (n,)."""
    pieces = end - begin
    cost = model.gap + model.gap_piece * pieces
    width = np.clip(pieces - DOOR_PIECES[0], 0, len(DOOR_PIECES) - 1)
    as_door = doors.of(plane, begin, width)
    return np.asarray(np.where(np.isin(pieces, DOOR_PIECES), np.minimum(cost, as_door), cost))


def gaps_of(is_wall: Cells) -> list[tuple[int, int]]:
    """Begin and end of each stretch without wall."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], is_wall, [True]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def best_runs(odds: FloatArray) -> tuple[FloatArray, np.ndarray, np.ndarray]:
    """Of each row the stretch with the largest sum: (n,) sum, begin, end (Kadane)."""
    n = len(odds)
    running, start = np.zeros(n), np.zeros(n, dtype=np.int64)
    best, begin, end = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    for j in range(odds.shape[1]):
        running += odds[:, j]
        is_lost = running < 0
        running[is_lost], start[is_lost] = 0.0, j + 1
        is_better = running > best
        best[is_better], begin[is_better], end[is_better] = running[is_better], start[is_better], j + 1
    return best, begin, end
