"""Where the robot drove, as a line on a floor plan."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.model.navigation import Navigation
from station.places.making.scale import units_per_metre

STEP_M = 0.1  # between its points
MAX_POINTS = 5000


def driven_path(navigation: Navigation, R_ground_map: FloatArray) -> FloatArray:
    """(n, 2) where the body was, on the ground, in time order; a few points for each metre."""
    p = navigation.trajectory.T_world_body[:, :3, 3]
    p = (p[np.isfinite(p).all(axis=1)] @ R_ground_map.T)[:, :2]
    if not len(p):
        return p
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    steps = min(int(travelled[-1] / (STEP_M * units_per_metre(navigation))) + 2, MAX_POINTS)
    return np.asarray(
        p[np.unique(np.searchsorted(travelled, np.linspace(0, travelled[-1], steps)).clip(0, len(p) - 1))]
    )
