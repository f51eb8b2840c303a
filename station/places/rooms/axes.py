"""The axes of a plan: most walls stand at right angles, and drawn along the page they are easiest to read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from shared.geometry import FloatArray, yaw_rotation
from station.places.rooms.lengths import WALL_M
from station.places.rooms.sides import best_runs
from station.places.rooms.surfaces import LINE_M, PIECE_M, SIDES, Seen, Side, find_pieces
from station.places.rooms.wall_model import WallModel

COARSE, FINE = np.radians(np.arange(0.0, 90.0, 1.0)), np.radians(np.arange(-1.0, 1.01, 0.1))
BIN_M = 0.5 * WALL_M
MOST_POINTS = 20_000
TURNS = np.radians(np.arange(-4.0, 4.1, 0.5))  # of the axes by landmarks, tried on walls: their peak is a degree wide
NEAR_PLANES = 7  # of which the best counts
LEAST_THIRD = 3  # landmarks: of fewer the median is any of them
STRAIGHTENED = 3  # times: then it moves by less than a tenth of a degree


def wall_yaw(p: FloatArray, metre: float) -> float:
    """Rad, in [0, pi/2): along it and across it the points (n, 2) gather in the fewest, fullest lines.

    The concentration of both projections, as for aligning scans by their histograms (Weiss and von Puttkamer, 1995).
    """
    p = p[np.isfinite(p).all(axis=1)]
    if len(p) < 2:
        return 0.0
    p = p[:: -(-len(p) // MOST_POINTS)]
    p = (p - np.median(p, axis=0)) / (BIN_M * metre)
    p = p[(np.abs(p) < 2000).all(axis=1)]  # a point far away would stretch the histograms without end
    coarse = COARSE[int(np.argmax([_concentration(p, yaw) for yaw in COARSE]))]
    fine = coarse + FINE
    return float(fine[int(np.argmax([_concentration(p, yaw) for yaw in fine]))] % (np.pi / 2))


def plan_axes(R_ground_map: FloatArray, p_map: FloatArray, metre: float) -> FloatArray:
    """R_ground_map (3, 3) turned about z by less than 45 degrees, so that the walls lie along x and y."""
    yaw = wall_yaw((p_map @ R_ground_map.T)[:, :2], metre)
    return yaw_rotation(-(yaw if yaw <= np.pi / 4 else yaw - np.pi / 2)) @ R_ground_map


def turn_to_walls(seen: Seen, model: WallModel) -> float:
    """Rad, among TURNS: the turn of the axes in which the planes show the longest walls, and those stand straight.

    Furniture stands askew and bare walls show few landmarks; but no sight passes a wall in its own direction.
    """
    walls = [_longest_walls(seen.turned(turn), model) for turn in TURNS]
    if not any(walls):
        return 0.0
    k = int(np.argmax([sum(wall.weight**2 for wall in found) for found in walls]))  # a few long ones, not many short
    turn = float(TURNS[k])
    for _ in range(STRAIGHTENED):
        turned = seen.turned(turn)
        askew = _askew(turned, _longest_walls(turned, model))
        turn = float(np.clip(turn - askew, TURNS[0], TURNS[-1]))  # what is no wall may stand at any angle
    return turn


@dataclass(frozen=True, slots=True)
class _Wall:
    """The most likely stretch of one plane. Metres, in the axes of what was seen."""

    side: Side
    at: float
    begin: float
    end: float
    weight: float  # nats: for a wall


def _longest_walls(seen: Seen, model: WallModel) -> list[_Wall]:
    """Of the planes that are likelier than those beside them."""
    pieces = find_pieces(seen)
    if pieces is None:
        return []
    table, found = np.array(model.wall), []
    for side in SIDES:
        low, along = pieces.low[side[0]], pieces.low[1 - side[0]]
        weight, begin, end = best_runs(table[pieces.classes[side]])
        is_best = (weight > 0) & (weight == ndimage.maximum_filter1d(weight, NEAR_PLANES))
        for k in np.flatnonzero(is_best).tolist():
            ends = along + PIECE_M * begin[k], along + PIECE_M * end[k]
            found.append(_Wall(side, low + LINE_M * k, *ends, float(weight[k])))
    return found


def _askew(seen: Seen, walls: list[_Wall]) -> float:
    """Rad: by how much the landmarks of walls stand turned to the left of their planes; the median of all nats.

    Of each wall the line through the medians of its first and last third (Tukey's resistant line).
    """
    turned, weight = [], []
    for wall in walls:
        axis, sign = wall.side
        across, along = seen.p[:, axis] - wall.at, seen.p[:, 1 - axis]
        on = (sign * seen.towards[:, axis] > 0) & (np.abs(across) < WALL_M) & (along > wall.begin) & (along < wall.end)
        in_order = np.flatnonzero(on)[np.argsort(along[on])]
        third = len(in_order) // 3
        if third < LEAST_THIRD:
            continue
        first, last = in_order[:third], in_order[-third:]
        run, rise = (float(np.median(v[last]) - np.median(v[first])) for v in (along, across))
        turned.append((1 if axis else -1) * rise / max(run, WALL_M))
        weight.append(wall.weight)
    return weighted_median(np.array(turned), np.array(weight)) if turned else 0.0


def weighted_median(values: FloatArray, weight: FloatArray) -> float:
    """Of values (n,), n > 0: half of the weight is at most this."""
    order = np.argsort(values)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(values[order[min(int(half), len(values) - 1)]])


def _concentration(p: FloatArray, yaw: float) -> float:
    c, s = np.cos(yaw), np.sin(yaw)
    total = 0.0
    for d in ((c, s), (-s, c)):
        position = np.round(p @ np.array(d)).astype(np.int64)
        total += float((np.bincount(position - position.min()).astype(np.float64) ** 2).sum())
    return total
