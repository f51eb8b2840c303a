"""Which keyframes see the same, feature by feature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shared.geometry import IntArray
from station.slam.sfm.colmap import pycolmap
from station.slam.sfm.config import MatchConfig
from station.slam.sfm.features import COLMAP_PIXEL_CENTRE, Features

Descriptors = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Keyframes a < b that see the same, with the features they share."""

    a: int
    b: int
    pairs: IntArray  # (M, 2) feature of a, feature of b
    geometry: pycolmap.TwoViewGeometry = field(repr=False)


def match_descriptors(a: Descriptors, b: Descriptors, max_ratio: float) -> IntArray:
    """Pairs (M, 2) of descriptors that are each other's nearest, and clearly nearer than the second nearest.

    Source: Lowe, IJCV 60(2), 2004, section 7.1 (ratio test), both ways.
    """
    if len(a) < 2 or len(b) < 2:
        return np.empty((0, 2), dtype=np.int64)
    similarity = a @ b.T
    every = np.arange(len(a))
    best = similarity.argmax(axis=1)
    first = similarity[every, best]
    similarity[every, best] = -1.0  # twice a maximum is five times as fast as a partition
    second = similarity.max(axis=1)
    similarity[every, best] = first
    rows = np.flatnonzero(_is_clear(first, second, max_ratio))
    columns = best[rows]
    # The other way round is asked of these only: between images far apart they are few.
    first, of_columns = first[rows], similarity[:, columns]
    is_mutual = first == of_columns.max(axis=0)
    of_columns[rows, np.arange(len(rows))] = -1.0
    good = is_mutual & _is_clear(first, of_columns.max(axis=0), max_ratio)
    return np.column_stack([rows[good], columns[good]]).astype(np.int64)


def _is_clear(first: npt.NDArray[np.float32], second: npt.NDArray[np.float32], max_ratio: float) -> BoolArray:
    """Whether the nearest is clearly nearer than the second; of unit vectors, distance^2 = 2 - 2 * similarity."""
    return (1.0 - first) < max_ratio**2 * (1.0 - second)


class Shortlist:
    """Finds older keyframes that look alike, by matching the largest features only: no vocabulary is needed."""

    def __init__(self, config: MatchConfig, max_keyframes: int = 400) -> None:
        self._config = config
        self._max_keyframes = max_keyframes
        self._descriptors: list[Descriptors] = []

    def add(self, features: Features) -> None:
        self._descriptors.append(features.descriptors[: self._config.shortlist_features])

    def most_alike(self, query: Features, num_older: int) -> list[int]:
        """Among the first num_older keyframes: those that look most like the query, best first."""
        descriptors = query.descriptors[: self._config.shortlist_features]
        candidates = range(num_older)
        if num_older > self._max_keyframes:  # long drives: the work per keyframe stays bounded
            candidates = np.unique(np.linspace(0, num_older - 1, self._max_keyframes).astype(int)).tolist()
        scores = []
        for k in candidates:
            pairs = match_descriptors(descriptors, self._descriptors[k], self._config.max_ratio)
            scores.append((len(pairs), k))
        scores.sort(key=lambda score: (-score[0], score[1]))
        chosen: list[int] = []
        for count, k in scores:
            if count < self._config.min_shortlist_matches or len(chosen) == self._config.num_shortlist:
                break
            # Neighbours of a chosen one tell little that is new.
            if all(abs(k - other) > 1 for other in chosen):
                chosen.append(k)
        return chosen


def verify(
    a: int,
    b: int,
    pairs: IntArray,
    features: Sequence[Features],
    camera: pycolmap.Camera,
    config: MatchConfig,
    seed: int,
) -> Match | None:
    """The pairs of two keyframes that agree on one motion; None where they are too few."""
    if len(pairs) < config.min_inliers:
        return None
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = config.min_inliers
    options.ransac.max_error = config.max_error_px
    options.ransac.random_seed = seed
    options.ransac.max_num_trials = 2000
    options.detect_watermark = False
    geometry = pycolmap.estimate_calibrated_two_view_geometry(
        camera,
        features[a].uv_ideal_px + COLMAP_PIXEL_CENTRE,
        camera,
        features[b].uv_ideal_px + COLMAP_PIXEL_CENTRE,
        pairs.astype(np.uint32),
        options,
    )
    inliers = np.asarray(geometry.inlier_matches, dtype=np.int64).reshape(-1, 2)
    if len(inliers) < config.min_inliers:
        return None
    return Match(a, b, inliers, geometry)
