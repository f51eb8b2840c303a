"""Which landmarks are worth clustering: finite, seen often enough, well triangulated, not alone."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import IntArray
from station.model.navigation import Navigation
from station.places.making.scale import observation_distances

MIN_OBSERVATIONS = 3  # two views triangulate also a wrong correspondence; the third confirms it
MAX_SIGMA_SHARE = 0.15  # of the viewing distance: a less certain landmark blurs a place
MAX_DISTANCE_SHARE = 4.0  # of the viewing distance: farther points have no parallax
NEIGHBOURS = 5
MAX_SPACING_RATIO = 6.0  # distance to the 5th neighbour against the median of all: above it a landmark stands alone


def usable_landmarks(navigation: Navigation, unit: float) -> IntArray:
    """(n,) indices of the landmarks that may form places. `unit` is the viewing distance, map units."""
    landmarks = navigation.landmarks
    keep = np.isfinite(landmarks.p_world).all(axis=1)
    observations = landmarks.num_observations
    # A backend that saves each landmark once (the thesis' filter) has no third view to ask for.
    if (observations >= MIN_OBSERVATIONS).mean() > 0.3:
        keep &= observations >= MIN_OBSERVATIONS
    variance = np.trace(landmarks.cov_world, axis1=1, axis2=2)
    keep &= ~(variance > (MAX_SIGMA_SHARE * unit) ** 2)
    nearest_view = np.full(len(landmarks), np.inf)
    np.minimum.at(nearest_view, landmarks.observed_landmark, observation_distances(navigation))
    keep &= (observations == 0) | (nearest_view <= MAX_DISTANCE_SHARE * unit)
    index = np.flatnonzero(keep)
    if len(index) <= NEIGHBOURS:
        return index
    spacing = cKDTree(landmarks.p_world[index]).query(landmarks.p_world[index], k=NEIGHBOURS + 1)[0][:, -1]
    return index[spacing <= MAX_SPACING_RATIO * max(float(np.median(spacing)), 1e-3 * unit)]
