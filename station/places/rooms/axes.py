"""The axes of a plan: most walls stand at right angles, and drawn along the page they are easiest to read."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from shared.geometry import FloatArray, yaw_rotation
from station.places.rooms.lengths import WALL_M
from station.places.rooms.sides import best_runs
from station.places.rooms.surfaces import SIDES, Seen, find_piece_classes
from station.places.rooms.wall_model import WallModel

COARSE, FINE = np.radians(np.arange(0.0, 90.0, 1.0)), np.radians(np.arange(-1.0, 1.01, 0.1))
BIN_M = 0.5 * WALL_M
MOST_POINTS = 20_000
TURNS = np.radians(np.arange(-4.0, 4.1, 0.5))  # of the axes by landmarks, tried on walls: their peak is a degree wide
NEAR_PLANES = 7  # of which the best counts


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
    """Rad, a few degrees: the turn of the axes in which the planes show the longest walls.

    Furniture stands askew and bare walls show few landmarks; but no sight passes a wall in its own direction.
    """
    length = np.array([_wall_length(seen.turned(turn), model) for turn in TURNS])
    k = int(length.argmax())
    if not 0 < k < len(TURNS) - 1:
        return float(TURNS[k])
    before, here, after = length[k - 1 : k + 2]  # the vertex of the parabola through them
    return float(TURNS[k] + 0.5 * (before - after) / min(before - 2 * here + after, -1e-12) * (TURNS[1] - TURNS[0]))


def _wall_length(seen: Seen, model: WallModel) -> float:
    """Sum of squares of what the walls of the best planes weigh: a few long ones count more than many short ones."""
    classes = find_piece_classes(seen)
    if classes is None:
        return 0.0
    table, total = np.array(model.wall), 0.0
    for side in SIDES:
        weight, _, _ = best_runs(table[classes[side]])
        total += float((weight[weight == ndimage.maximum_filter1d(weight, NEAR_PLANES)] ** 2).sum())
    return total


def _concentration(p: FloatArray, yaw: float) -> float:
    c, s = np.cos(yaw), np.sin(yaw)
    total = 0.0
    for d in ((c, s), (-s, c)):
        position = np.round(p @ np.array(d)).astype(np.int64)
        total += float((np.bincount(position - position.min()).astype(np.float64) ** 2).sum())
    return total
