"""Landmarks → clusters. The thesis' DBSCAN, and a default whose lengths come from the cloud (docs/places.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sklearn.cluster import DBSCAN

from shared.geometry import FloatArray, IntArray
from station.navigation import Navigation
from station.places.config import PlacesConfig, ThesisConfig
from station.places.modes import climb, equalising_weights, smooth_density
from station.places.outliers import usable_landmarks
from station.places.scale import viewing_distance
from station.places.voxels import voxelise

NOISE = -1
MIN_LANDMARKS = 10  # fewer points have no centroid worth naming
MIN_SHARE = 0.1  # of the median hill's landmarks: crumbs at the edge of the view are no places
CELL_SHARE = 1 / 80  # of the viewing distance, about triangulation noise: only bounds the work in dense clouds
EQUAL_SHARE = 1 / 30  # of the viewing distance: the ball in which points count as one texture
SMOOTHING_SHARE = 0.08  # of the viewing distance: hills of furniture size (docs/places.md has the sweep)
MIN_PROMINENCE = 0.15  # a hill rises so much of its height above the saddle to its neighbour, or it is a part of it


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """A label for every landmark, and where the lengths came from."""

    label: IntArray  # (M,) 0..n-1, or NOISE
    quality: FloatArray  # (n,) 0..1, how clearly each cluster stands out
    parameters: dict[str, object]  # the effective lengths and counts

    @property
    def count(self) -> int:
        return len(self.quality)

    def members(self, cluster: int) -> IntArray:
        """(n,) landmark indices of one cluster."""
        return np.flatnonzero(self.label == cluster)


def cluster_landmarks(navigation: Navigation, config: PlacesConfig, *, length_unit: float | None = None) -> Clusters:
    """Clusters of a navigation's landmarks in the configured mode.

    `length_unit` (map units) replaces the cloud's own viewing distance: a second navigation is clustered with the
    map's, carried over by the registration's scale. The thesis mode has no such unit and ignores it.
    An empty or hopeless cloud has no clusters: an ordinary result.
    """
    if config.mode == "thesis":
        return cluster_thesis(navigation.landmarks.p_world, config.thesis, is_metric=navigation.is_metric)
    return cluster_default(navigation, config, length_unit=length_unit)


def centre_and_normalise(p: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Points (M, 3) about their centroid, within the unit ball; with the centre (3,) and the scale they had.

    Thesis 5.3: clouds of arbitrary scale are centred and normalised. By the largest distance, as MATLAB users do.
    """
    centre = p.mean(axis=0)
    radius = float(np.linalg.norm(p - centre, axis=1).max(initial=0.0))
    scale = radius if radius > 0 else 1.0
    return (p - centre) / scale, centre, scale


def cluster_thesis(p_world: FloatArray, config: ThesisConfig, *, is_metric: bool) -> Clusters:
    """DBSCAN with given eps and MinPts (thesis 4.3.3), on the normalised cloud where the scale is arbitrary."""
    label = np.full(len(p_world), NOISE, dtype=np.int64)
    finite = np.isfinite(p_world).all(axis=1)
    normalise = not is_metric if config.normalise is None else config.normalise
    if finite.any():
        p = p_world[finite]
        if normalise:
            p, _, _ = centre_and_normalise(p)
        label[finite] = DBSCAN(eps=config.eps, min_samples=config.min_pts).fit(p).labels_
    count = int(label.max(initial=NOISE)) + 1
    parameters = {"eps": config.eps, "min_pts": config.min_pts, "normalised": normalise}
    return Clusters(label=label, quality=np.ones(count), parameters=dict(parameters))


def cluster_default(navigation: Navigation, config: PlacesConfig, *, length_unit: float | None = None) -> Clusters:
    """Hills of the landmarks' density, smoothed to the size of what one looks at.

    Nothing is set in metres: the unit is the median distance between cameras and landmarks. See modes.py for the
    hierarchy of hills and docs/places.md for why this repeats between two drives where DBSCAN does not.
    """
    landmarks = navigation.landmarks
    unit = length_unit if length_unit is not None else viewing_distance(navigation)
    label = np.full(len(landmarks), NOISE, dtype=np.int64)
    usable = usable_landmarks(navigation, unit) if unit is not None else np.zeros(0, dtype=np.int64)
    if unit is None or len(usable) < MIN_LANDMARKS:
        return Clusters(label=label, quality=np.zeros(0), parameters={"usable_landmarks": len(usable)})
    p = landmarks.p_world[usable]
    cells = voxelise(p, smallest=CELL_SHARE * unit, max_cells=config.voxelise_above)
    bandwidth = SMOOTHING_SHARE * unit * config.size_factor
    reach = bandwidth * config.eps_factor
    density = smooth_density(cells.p, equalising_weights(cells, EQUAL_SHARE * unit), bandwidth)
    modes = climb(cells.p, density, reach, MIN_PROMINENCE)
    hill = modes.label[cells.cell_of_point]
    size = np.bincount(hill, minlength=len(modes.peak))
    kept = np.flatnonzero(size >= max(MIN_LANDMARKS, MIN_SHARE * np.median(size)))
    new_label = np.full(len(size), NOISE, dtype=np.int64)
    new_label[kept] = np.arange(len(kept))
    label[usable] = new_label[hill]
    parameters: dict[str, object] = {
        "viewing_distance": unit,
        "smoothing": bandwidth,
        "reach": reach,
        "cell": cells.size,
        "min_prominence": MIN_PROMINENCE,
        "usable_landmarks": len(usable),
    }
    return Clusters(label=label, quality=modes.prominence[kept], parameters=parameters)
