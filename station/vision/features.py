"""Local image features: what appearance means here. SIFT as RootSIFT, in bytes.

Source: Lowe, IJCV 60(2), 2004; square root of the L1-normalised descriptor: Arandjelovic and Zisserman, CVPR 2012.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shared.calibration import CameraCalibration
from shared.errors import DataError
from shared.geometry import FloatArray
from station.model.frames import ImageArray, ImageFrame

DescriptorArray = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]

MAX_FEATURES = 800
MAX_DETAILS = 1200
CONTRAST = 0.02  # of what is looked for
DETAIL_CONTRAST = 0.01  # of what a map takes besides: its landmarks need not be recognised by themselves
LAYERS = 3  # per octave, OpenCV's default
LARGE_WIDTH_PX = 500  # from here on an image is described at half its size; docs/localisation.md has the comparison
# Root of a share of the L1 norm, times this: a unit vector of length 512 whose entries rarely reach 255.
BYTE_SCALE = 512.0


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Keypoints of one image, those with the most contrast first (or the largest, where COLMAP found them)."""

    uv_px: FloatArray  # (n, 2) as measured, distorted pixels
    descriptors: DescriptorArray  # (n, 128) RootSIFT in bytes

    def __len__(self) -> int:
        return len(self.uv_px)


@dataclass(frozen=True, slots=True, eq=False)
class Details:
    """What a map takes from an image: its features, and fainter ones."""

    seen: Features  # exactly those that a FeatureExtractor finds
    features: Features  # all, no two at one place


class FeatureExtractor:
    """Detects and describes. Holds the library's detector, so one per thread."""

    def __init__(self, max_features: int = MAX_FEATURES) -> None:
        self._sift = _detector(max_features, CONTRAST)

    def extract(self, grey: ImageArray) -> Features:
        """Features of an image (H, W); none on a featureless one."""
        return _find(self._sift, grey)[0]


class DetailExtractor:
    """The same for a map: one look gives what localisation sees in an image, and what else landmarks come from."""

    def __init__(self) -> None:
        self._sift = _detector(2 * MAX_DETAILS, DETAIL_CONTRAST)  # some are found twice

    def extract(self, grey: ImageArray) -> Details:
        found, response = _find(self._sift, grey)
        count = int(np.count_nonzero(response * np.float32(LAYERS) >= np.float32(CONTRAST)))
        if count > MAX_FEATURES:  # as OpenCV has it: those as strong as the last one are taken, too
            count = int(np.count_nonzero(response >= response[MAX_FEATURES - 1]))
        # A corner that was described twice, turned two ways, would become two landmarks.
        _, first = np.unique(found.uv_px, axis=0, return_index=True)
        rows = np.sort(first)[:MAX_DETAILS]
        seen = Features(found.uv_px[:count].copy(), found.descriptors[:count].copy())  # not the whole, kept alive
        return Details(seen, Features(found.uv_px[rows], found.descriptors[rows]))


def _detector(max_features: int, contrast: float) -> cv2.SIFT:
    # Without "precise", features lie a quarter of a pixel too far right and down (blobs at known places).
    return cv2.SIFT.create(max_features, LAYERS, contrast, enable_precise_upscale=True)


def _find(sift: cv2.SIFT, grey: ImageArray) -> tuple[Features, Float32Array]:
    """Features of an image (H, W) and their responses (n,): contrast over LAYERS. Their order depends on them only."""
    # SIFT doubles an image before it looks for details: of a large one, that octave is noise and costs most.
    scale = 0.5 if grey.shape[1] >= LARGE_WIDTH_PX else 1.0
    seen = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    keypoints, raw = sift.detectAndCompute(seen, None)
    if raw is None or not len(keypoints):
        return Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.uint8)), np.zeros(0, dtype=np.float32)
    uv = (np.array([k.pt for k in keypoints], dtype=np.float64) + 0.5) / scale - 0.5  # centres of pixels stay centres
    response = np.array([k.response for k in keypoints], dtype=np.float32)
    angle = np.array([k.angle for k in keypoints])
    order = np.lexsort((angle, uv[:, 1], uv[:, 0], -response))
    return Features(uv[order], to_bytes(np.asarray(raw, dtype=np.float32)[order])), response[order]


def extract_encoded(encoded: bytes, extractor: FeatureExtractor) -> Features:
    """Features of a JPEG or PNG file; none where it cannot be decoded."""
    try:
        grey = ImageFrame(index=0, t_robot_ns=0, exposure_ns=0, encoded=encoded).grey()
    except DataError:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.uint8))
    return extractor.extract(grey)


def to_bytes(sift: Float32Array) -> DescriptorArray:
    """RootSIFT (n, 128) of SIFT descriptors (n, 128), in bytes."""
    share = sift / np.maximum(np.abs(sift).sum(axis=1, keepdims=True), 1e-12)
    return np.clip(np.round(np.sqrt(share) * BYTE_SCALE), 0, 255).astype(np.uint8)


def to_floats(descriptors: DescriptorArray) -> Float32Array:
    """(n, 128) of unit length but for the half a percent that bytes cost: a dot product is a similarity 0..1."""
    return descriptors.astype(np.float32) / np.float32(BYTE_SCALE)


def to_unit(descriptors: DescriptorArray) -> Float32Array:
    """(n, 128) of unit length, whatever the length in bytes: that of COLMAP's descriptors is not ours."""
    found = descriptors.astype(np.float32)
    return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)


def similarities(a: Features, b: Features) -> Float32Array:
    """(n, m) how alike the features of two images are, each with each, 0..1."""
    return to_unit(a.descriptors) @ to_unit(b.descriptors).T


def to_rays(camera: CameraCalibration, uv_px: FloatArray) -> FloatArray:
    """Normalised coordinates (n, 2) of distorted pixels (n, 2): the ray is (x, y, 1) in the camera frame."""
    if not len(uv_px):
        return np.zeros((0, 2))
    points = np.ascontiguousarray(uv_px, dtype=np.float64).reshape(-1, 1, 2)
    distortion = np.array(camera.distortion)
    if camera.model == "equidistant":
        return np.asarray(cv2.fisheye.undistortPoints(points, camera.K, distortion), dtype=np.float64).reshape(-1, 2)
    # The default five iterations leave a pixel of error in the corners of a lens like the reference robot's.
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-9)
    out = cv2.undistortPoints(points, camera.K, distortion, criteria=criteria)
    return np.asarray(out, dtype=np.float64).reshape(-1, 2)
