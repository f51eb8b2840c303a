"""Where a plane is a wall and where it has a gap, a door or an opening: the likeliest sequence of both (Viterbi)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.places.rooms.lengths import DOOR_M, OPENING_M
from station.places.rooms.surfaces import PIECE_M, SIDES, Side, Surfaces
from station.places.rooms.wall_model import WallModel
from station.places.space.space import Cells

DOOR_PIECES = range(round(DOOR_M[0] / PIECE_M) - 1, round(DOOR_M[1] / PIECE_M) + 2)  # either end may err by half of one
OPENING_PIECES = range(DOOR_PIECES.stop, round(OPENING_M[1] / PIECE_M) + 2)
PASSAGE_PIECES = np.array([*DOOR_PIECES, *OPENING_PIECES])
BESIDE = DOOR_PIECES.start  # pieces of wall between two passages at least: several in a row are an open side
LEAST_ODDS = -1e4  # nats for a wall where the body was, in sums


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """Log odds of walls on the planes of `Surfaces`, seen from either side."""

    odds: dict[Side, FloatArray]  # (planes, pieces) of a wall
    is_wall: dict[Side, Cells]  # (planes, pieces) the likeliest labels of whole planes
    total: dict[Side, FloatArray]  # (planes, pieces + 1) cumulated score of these labels
    area: FloatArray  # (2 X + 1, 2 Y + 1) cumulated score of the cells below a pair of planes


def weigh_sides(surfaces: Surfaces, model: WallModel) -> Sides:
    """Odds of all planes at once."""
    odds = {side: np.array(model.wall)[classes] for side, classes in surfaces.classes.items()}
    for side, classes in (surfaces.feet or {}).items():
        odds[side] += model.foot_weight * np.array(model.foot)[classes]
    for side in SIDES:
        odds[side][surfaces.passed[side[0]]] = -np.inf
    is_wall, total = {}, {}
    for side in SIDES:
        is_wall[side] = likeliest_walls(odds[side], model)
        score = score_of(is_wall[side], odds[side], model)
        total[side] = np.concatenate([np.zeros((len(score), 1)), np.cumsum(score, axis=1)], axis=1)
    cells = model.area_weight * np.array(model.area)[surfaces.area_classes]
    quarters = np.repeat(np.repeat(cells, 2, axis=0), 2, axis=1) / 4  # planes lie in the middle of cells, too
    area = np.zeros((quarters.shape[0] + 1, quarters.shape[1] + 1))
    area[1:, 1:] = quarters.cumsum(axis=0).cumsum(axis=1)
    return Sides(odds, is_wall, total, area)


def likeliest_walls(odds: FloatArray, model: WallModel) -> Cells:
    """(planes, pieces) the best sequence of wall and gaps (Viterbi); doors and openings are cheaper ones."""
    n, count = odds.shape
    wall = np.full((n, count + 1), -np.inf)  # best score so far that ends with a wall before piece j
    gap = np.full((n, count + 1), -np.inf)
    wall[:, 0], gap[:, 0] = 0.0, -model.gap
    costs = passage_costs(model)
    sums = np.concatenate([np.zeros((n, 1)), np.maximum(odds, LEAST_ODDS).cumsum(axis=1)], axis=1)
    came = np.zeros((n, count + 1), dtype=np.int64)  # how many pieces of gap lie before the wall: 0, a door, or -1
    opened = np.zeros((n, count + 1), dtype=np.bool_)
    for j in range(1, count + 1):
        end = j - 1 - PASSAGE_PIECES  # of the wall before each passage
        begin = np.maximum(end - BESIDE, 0)
        passed = wall[:, begin] + sums[:, np.maximum(end, 0)] - sums[:, begin] - costs
        before = np.column_stack([wall[:, j - 1], gap[:, j - 1], np.where(end < 0, -np.inf, passed)])
        best = before.argmax(axis=1)
        came[:, j] = np.array([0, -1, *PASSAGE_PIECES])[best]
        wall[:, j] = before[np.arange(n), best] + odds[:, j - 1]
        opened[:, j] = wall[:, j - 1] - model.gap > gap[:, j - 1]
        gap[:, j] = np.maximum(wall[:, j - 1] - model.gap, gap[:, j - 1]) - model.gap_piece
    return _traced(wall[:, -1] >= gap[:, -1], came, opened)


def _traced(ends_with_wall: Cells, came: IntArray, opened: Cells) -> Cells:
    """Labels (planes, pieces) from how each was reached."""
    count = came.shape[1] - 1
    is_wall = np.zeros((len(came), count), dtype=np.bool_)
    here = ends_with_wall.copy()
    skip, stay = (np.zeros(len(came), dtype=np.int64) for _ in range(2))  # pieces of a passage, then of wall, to pass
    for j in range(count, 0, -1):
        passing = skip > 0
        staying = ~passing & (stay > 0)
        is_wall[:, j - 1] = here & ~passing
        skip[passing] -= 1
        stay[staying] -= 1
        of_wall, of_gap = here & ~passing & ~staying, ~here & ~passing
        skip[of_wall] = np.maximum(came[of_wall, j], 0)
        stay[of_wall] = np.where(came[of_wall, j] > 0, BESIDE, 0)
        here[of_wall] = came[of_wall, j] >= 0
        here[of_gap] = opened[of_gap, j]
    return is_wall


def score_of(is_wall: Cells, odds: FloatArray, model: WallModel) -> FloatArray:
    """(planes, pieces) what labels gain or cost; all pieces of a gap bear its cost, also for sides that end in it."""
    edges = np.diff(np.pad(~is_wall, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, begin), (_, end) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    share = gap_costs(end - begin, model) / (end - begin)
    steps = np.zeros(edges.shape)
    steps[row, begin] = share
    steps[row, end] = -share
    return np.where(is_wall, odds, -steps.cumsum(axis=1)[:, :-1])


def gap_costs(pieces: IntArray, model: WallModel) -> FloatArray:
    """(n,) of gaps of so many pieces."""
    cost = model.gap + model.gap_piece * pieces
    for widths, least in ((DOOR_PIECES, model.door), (OPENING_PIECES, model.opening)):
        cost = np.where(np.isin(pieces, widths), np.minimum(cost, least), cost)
    return np.asarray(cost)


def passage_costs(model: WallModel) -> FloatArray:
    """(n,) of doors and openings of PASSAGE_PIECES."""
    return np.where(np.isin(PASSAGE_PIECES, DOOR_PIECES), model.door, model.opening)


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
