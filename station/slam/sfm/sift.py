"""SIFT features of a keyframe by pycolmap, and their place in an ideal pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from station.model.frames import ImageArray
from station.slam.sfm.colmap import COLMAP_PIXEL_CENTRE, pycolmap
from station.slam.sfm.config import FeatureConfig
from station.vision.features import Features
from station.vision.lens import Lens


@dataclass(frozen=True, slots=True, eq=False)
class PinholeFeatures(Features):
    """The largest first."""

    uv_ideal_px: FloatArray  # (N, 2) where a pinhole camera with the same K would see them


class SiftExtractor:
    """Finds features; one per thread."""

    def __init__(self, config: FeatureConfig) -> None:
        options = pycolmap.FeatureExtractionOptions()
        options.use_gpu = False
        options.num_threads = 1
        options.sift.max_num_features = config.max_features
        options.sift.first_octave = config.first_octave
        options.sift.peak_threshold = config.peak_threshold
        options.sift.max_num_orientations = 1
        self._extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)

    def extract(self, grey: ImageArray, lens: Lens) -> PinholeFeatures:
        """Features of an image (H, W)."""
        keypoints, found = self._extractor.extract_from_uint8_array(np.ascontiguousarray(grey))
        table = pycolmap.keypoints_to_matrix(keypoints)
        uv = table[:, :2].astype(np.float64) - COLMAP_PIXEL_CENTRE
        order = np.argsort(-table[:, 2], kind="stable") if len(table) else np.empty(0, np.int64)
        uv = uv[order]
        return PinholeFeatures(uv, np.asarray(found.data, dtype=np.uint8)[order], ideal_pixels(uv, lens))


def ideal_pixels(uv_px: FloatArray, lens: Lens) -> FloatArray:
    """Distorted pixels (N, 2) → pixels (N, 2) of the same camera without distortion."""
    camera = lens.camera
    return lens.unproject(uv_px) * [camera.fx, camera.fy] + [camera.cx, camera.cy]
