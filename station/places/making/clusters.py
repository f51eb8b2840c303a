"""Landmarks → clusters. The thesis' DBSCAN, and a default whose lengths come from the cloud (docs/places.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import FloatArray, IntArray
from station.model.navigation import Navigation
from station.places.making.config import PlacesConfig, ThesisConfig
from station.places.making.modes import climb, equalising_weights, smooth_density
from station.places.making.outliers import usable_landmarks
from station.places.making.scale import viewing_distance
from station.places.making.voxels import voxelise

NOISE = -1
MIN_LANDMARKS = 10  # fewer points have no centroid worth naming
FEW_LANDMARKS = 25  # a hill of so many is half as trustworthy as its prominence says
MIN_SHARE = 0.05  # of the hill that a landmark typically lies on: crumbs come and go from drive to drive
CELL_SHARE = 1 / 80  # of the viewing distance, about triangulation noise: only bounds the work in dense clouds
THESIS_CELL_SHARE = 1 / 20  # of DBSCAN's eps: moves a point by less than a twentieth of it
EQUAL_SHARE = 1 / 30  # of the viewing distance: the ball in which points count as one texture
SMOOTHING_SHARE = 0.08  # of the viewing distance: hills of furniture size (docs/places.md)
REACH = 3.0  # of the smoothing: steps that cross the gaps between landmarks; from half of it on, more changes little
SAMPLE = 16  # points that a kernel needs to tell a hill from chance: sparse clouds are smoothed more
MIN_PROMINENCE = 0.2  # a hill rises so much of its height above the saddle to its neighbour, or it is a part of it
MAX_SPAN = 0.4  # of the viewing distance: peaks farther apart are two places, however even the wall between them
MIN_SIGNIFICANCE = 2.0  # and so many standard deviations: what chance makes in one drive of 20


@dataclass(frozen=True, slots=True)
class Lengths:
    """The lengths that decide how large places are."""

    viewing_distance: float
    smoothing: float

    def scaled(self, scale: float) -> Lengths:
        return Lengths(self.viewing_distance * scale, self.smoothing * scale)


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


def cluster_landmarks(navigation: Navigation, config: PlacesConfig, *, lengths: Lengths | None = None) -> Clusters:
    """Clusters of a navigation's landmarks in the configured mode.

    `lengths` (this navigation's units) come from the map when a second navigation is compared with it: the places
    of both have one size then. The thesis mode has its own given lengths and ignores them.
    An empty or hopeless cloud has no clusters: an ordinary result.
    """
    if config.mode == "thesis":
        return cluster_thesis(
            navigation.landmarks.p_world,
            config.thesis,
            is_metric=navigation.is_metric,
            voxelise_above=config.voxelise_above,
        )
    return cluster_default(navigation, config, lengths)


def centre_and_normalise(p: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Points (M, 3) about their centroid, within the unit ball; with the centre (3,) and the scale they had.

    Thesis 5.3: clouds of arbitrary scale are centred and normalised. By the largest distance, as MATLAB users do.
    """
    centre = p.mean(axis=0)
    radius = float(np.linalg.norm(p - centre, axis=1).max(initial=0.0))
    scale = radius if radius > 0 else 1.0
    return (p - centre) / scale, centre, scale


def cluster_thesis(
    p_world: FloatArray, config: ThesisConfig, *, is_metric: bool, voxelise_above: int = 100_000
) -> Clusters:
    """DBSCAN with given eps and MinPts (thesis 4.3.3), on the normalised cloud where the scale is arbitrary.

    Of more than `voxelise_above` points, cells of a twentieth of eps are clustered, each weighing as many points as it
    holds: DBSCAN's memory grows with all pairs within eps.
    """
    label = np.full(len(p_world), NOISE, dtype=np.int64)
    finite = np.isfinite(p_world).all(axis=1)
    cell: float | None = None  # every point by itself
    normalise = not is_metric if config.normalise is None else config.normalise
    if finite.any():
        p = p_world[finite]
        if normalise:
            p, _, _ = centre_and_normalise(p)
        from sklearn.cluster import DBSCAN  # a second of imports that every other mode and every worker is spared

        dbscan = DBSCAN(eps=config.eps, min_samples=config.min_pts)
        if len(p) > voxelise_above:
            cells = voxelise(p, smallest=THESIS_CELL_SHARE * config.eps, max_cells=voxelise_above)
            label[finite] = dbscan.fit(cells.p, sample_weight=cells.count).labels_[cells.cell_of_point]
            cell = cells.size
        else:
            label[finite] = dbscan.fit(p).labels_
    count = int(label.max(initial=NOISE)) + 1
    parameters = {"eps": config.eps, "min_pts": config.min_pts, "normalised": normalise, "cell": cell}
    return Clusters(label=label, quality=np.ones(count), parameters=dict(parameters))


def cluster_default(navigation: Navigation, config: PlacesConfig, lengths: Lengths | None = None) -> Clusters:
    """Hills of the landmarks' density, smoothed to the size of what one looks at.

    Nothing is set in metres: the unit is the median distance between cameras and landmarks. See modes.py for the
    hierarchy of hills and docs/places.md for why this repeats between two drives where DBSCAN does not.
    """
    landmarks = navigation.landmarks
    unit = lengths.viewing_distance if lengths else viewing_distance(navigation)
    label = np.full(len(landmarks), NOISE, dtype=np.int64)
    usable = usable_landmarks(navigation, unit) if unit is not None else np.zeros(0, dtype=np.int64)
    if unit is None or len(usable) < MIN_LANDMARKS:
        return Clusters(label=label, quality=np.zeros(0), parameters={"usable_landmarks": len(usable)})
    p = landmarks.p_world[usable]
    smoothing = config.size_factor * max(
        SMOOTHING_SHARE * unit, sampling_distance(p), lengths.smoothing if lengths else 0.0
    )
    reach = REACH * smoothing * config.eps_factor
    cells = voxelise(p, smallest=CELL_SHARE * unit, max_cells=config.voxelise_above)
    density = smooth_density(cells.p, equalising_weights(cells, EQUAL_SHARE * unit), smoothing)
    modes = climb(
        cells.p,
        density,
        reach=reach,
        min_prominence=MIN_PROMINENCE,
        min_significance=MIN_SIGNIFICANCE,
        max_span=config.size_factor * MAX_SPAN * unit,
    )
    hill = modes.label[cells.cell_of_point]
    size = np.bincount(hill, minlength=len(modes.peak))
    kept = np.flatnonzero(size >= max(MIN_LANDMARKS, MIN_SHARE * (size**2).sum() / size.sum()))
    new_label = np.full(len(size), NOISE, dtype=np.int64)
    new_label[kept] = np.arange(len(kept))
    label[usable] = new_label[hill]
    parameters: dict[str, object] = {
        "viewing_distance": unit,
        "smoothing": smoothing,
        "reach": reach,
        "cell": cells.size,
        "max_span": config.size_factor * MAX_SPAN * unit,
        "min_prominence": MIN_PROMINENCE,
        "usable_landmarks": len(usable),
    }
    return Clusters(
        label=label, quality=modes.prominence[kept] * size[kept] / (size[kept] + FEW_LANDMARKS), parameters=parameters
    )


def sampling_distance(p: FloatArray) -> float:
    """Median distance to the SAMPLE-th neighbour: below it a density has nothing to say (the k-distance of DBSCAN)."""
    if len(p) <= SAMPLE:
        return 0.0
    sample = p[:: max(1, len(p) // 20_000)]
    return float(np.median(cKDTree(p).query(sample, k=SAMPLE)[0][:, -1]))
