"""Where a plane is a wall and where it has a gap, a door or an opening: the likeliest sequence of both (Viterbi)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from station.places.rooms.surfaces import SIDES, Side, Surfaces
from station.places.rooms.wall_model import WallModel
from station.places.space.space import Cells


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """Log odds of walls on the planes of `Surfaces`, seen from either side."""

    odds: dict[Side, FloatArray]  # (planes, pieces) of a wall
    is_wall: dict[Side, Cells]  # (planes, pieces) the likeliest labels of whole planes
    total: dict[Side, FloatArray]  # (planes, pieces + 1) cumulated score of these labels
    area: FloatArray  # (2 X + 1, 2 Y + 1) cumulated score of the cells below a pair of planes


def weigh_sides(surfaces: Surfaces, model: WallModel) -> Sides:
    """Odds of all planes at once."""
    table = np.array(model.wall)
    odds = {side: table[surfaces.classes[side]] for side in SIDES}
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
    """(planes, pieces) wall or gap: a gap costs once, and a little for each of its pieces."""
    wall, gap = np.zeros(len(odds)), np.full(len(odds), -model.gap)
    from_gap, from_wall = np.zeros(odds.shape, np.bool_), np.zeros(odds.shape, np.bool_)
    for j in range(odds.shape[1]):
        from_gap[:, j], from_wall[:, j] = gap > wall, wall - model.gap > gap
        wall, gap = np.maximum(wall, gap) + odds[:, j], np.maximum(wall - model.gap, gap) - model.gap_piece
    is_wall = np.zeros(odds.shape, np.bool_)
    here = wall >= gap
    for j in range(odds.shape[1] - 1, -1, -1):
        is_wall[:, j] = here
        here = np.where(here, ~from_gap[:, j], from_wall[:, j])
    return is_wall


def score_of(is_wall: Cells, odds: FloatArray, model: WallModel) -> FloatArray:
    """(planes, pieces) what labels gain or cost; a gap's own cost lies on its first piece."""
    score = np.where(is_wall, odds, -model.gap_piece)
    score[:, 1:][is_wall[:, :-1] & ~is_wall[:, 1:]] -= model.gap
    return score


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
