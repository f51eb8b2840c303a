"""Whether the features that two keyframes share agree on one motion; by pycolmap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from shared.geometry import IntArray
from station.slam.mapping.config import MatchConfig
from station.slam.sfm.colmap import COLMAP_PIXEL_CENTRE, pycolmap
from station.slam.sfm.sift import PinholeFeatures


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Keyframes a < b that see the same, with the features they share."""

    a: int
    b: int
    pairs: IntArray  # (M, 2) feature of a, feature of b
    geometry: pycolmap.TwoViewGeometry = field(repr=False)


def verify(
    a: int,
    b: int,
    pairs: IntArray,
    features: Sequence[PinholeFeatures],
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
