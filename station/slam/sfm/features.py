"""SIFT features of a keyframe, and their place in an ideal pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray
from station.frames import ImageArray
from station.slam.frontend.lens import Lens
from station.slam.sfm.colmap import pycolmap
from station.slam.sfm.config import FeatureConfig

# COLMAP puts the centre of the first pixel at (0.5, 0.5); ours is at (0, 0).
COLMAP_PIXEL_CENTRE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Of one image, the largest first."""

    uv_px: FloatArray  # (N, 2) as seen: distorted pixels
    uv_ideal_px: FloatArray  # (N, 2) where a pinhole camera with the same K would see them
    sift: npt.NDArray[np.uint8]  # (N, 128) as COLMAP gives them: a quarter of what unit vectors take

    def __len__(self) -> int:
        return len(self.uv_px)

    @property
    def descriptors(self) -> npt.NDArray[np.float32]:
        """(N, 128) of length 1; made anew each time."""
        found = self.sift.astype(np.float32)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)


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

    def extract(self, grey: ImageArray, lens: Lens) -> Features:
        """Features of an image (H, W)."""
        keypoints, found = self._extractor.extract_from_uint8_array(np.ascontiguousarray(grey))
        table = pycolmap.keypoints_to_matrix(keypoints)
        uv = table[:, :2].astype(np.float64) - COLMAP_PIXEL_CENTRE
        order = np.argsort(-table[:, 2], kind="stable") if len(table) else np.empty(0, np.int64)
        uv = uv[order]
        return Features(uv, ideal_pixels(uv, lens), np.asarray(found.data, dtype=np.uint8)[order])


def ideal_pixels(uv_px: FloatArray, lens: Lens) -> FloatArray:
    """Distorted pixels (N, 2) → pixels (N, 2) of the same camera without distortion."""
    camera = lens.camera
    return lens.unproject(uv_px) * [camera.fx, camera.fy] + [camera.cx, camera.cy]
