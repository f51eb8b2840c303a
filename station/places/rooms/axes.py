"""The axes of a plan: most walls stand at right angles, and drawn along the page they are easiest to read."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, yaw_rotation

COARSE, FINE = np.radians(np.arange(0.0, 90.0, 1.0)), np.radians(np.arange(-1.0, 1.01, 0.1))
BIN_M = 0.05  # as thick as a wall appears in a cloud
MOST_POINTS = 20_000


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


def _concentration(p: FloatArray, yaw: float) -> float:
    c, s = np.cos(yaw), np.sin(yaw)
    total = 0.0
    for d in ((c, s), (-s, c)):
        position = np.round(p @ np.array(d)).astype(np.int64)
        total += float((np.bincount(position - position.min()).astype(np.float64) ** 2).sum())
    return total
