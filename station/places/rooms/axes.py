"""The axes of a plan: most walls stand at right angles, and drawn along the page they are easiest to read."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from shared.geometry import FloatArray, yaw_rotation
from station.places.rooms.lengths import WALL_M
from station.places.rooms.rectangles import find_rectangles
from station.places.rooms.sides import weigh_sides
from station.places.rooms.surfaces import Seen, find_surfaces
from station.places.rooms.wall_model import WallModel

COARSE, FINE = np.radians(np.arange(0.0, 90.0, 1.0)), np.radians(np.arange(-1.0, 1.01, 0.1))
BIN_M = 0.5 * WALL_M
MOST_POINTS = 20_000
STEP, MOST_STEPS = np.radians(1.0), 4  # of the turns of the axes by landmarks that are tried on rooms


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


def turn_to_rooms(seen: Seen, model: WallModel) -> float:
    """Rad, a few degrees: the turn of the axes in which the likeliest rooms are the likeliest.

    Furniture stands askew and bare walls show few landmarks, so that the landmarks' own lines may be degrees off.
    """
    worth: dict[int, float] = {}

    def weigh(steps: Iterable[int]) -> int:
        """The best so far, by its number of steps."""
        for k in steps:
            if k not in worth:
                worth[k] = _worth(seen.turned(k * STEP), model)
        return max(worth, key=lambda k: (worth[k], -abs(k)))

    best = weigh(range(-MOST_STEPS, MOST_STEPS + 1, 2))
    best = weigh((best - 1, best + 1))
    near = sorted(k for k in worth if abs(k - best) <= 2)
    curved, sloped, _ = np.polyfit(np.array(near) - best, [worth[k] for k in near], 2)  # one pack more or less is noise
    top = -0.5 * sloped / curved if curved < 0 else 0.0
    return float((best + np.clip(top, -1.0, 1.0)) * STEP)


def _worth(seen: Seen, model: WallModel) -> float:
    """Nats, of the best rooms along the axes; 0 without any."""
    surfaces = find_surfaces(seen)
    return 0.0 if surfaces is None else find_rectangles(surfaces, weigh_sides(surfaces, model), model).worth


def _concentration(p: FloatArray, yaw: float) -> float:
    c, s = np.cos(yaw), np.sin(yaw)
    total = 0.0
    for d in ((c, s), (-s, c)):
        position = np.round(p @ np.array(d)).astype(np.int64)
        total += float((np.bincount(position - position.min()).astype(np.float64) ** 2).sum())
    return total
