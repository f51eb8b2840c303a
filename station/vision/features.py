"""Local image features: what appearance means here. SIFT as RootSIFT, in bytes.

A descriptor is turned as the gradients of its corner are, or, where the rig says which way is up, as the image is: a
robot on wheels sees no corner upside down, and what differs by a turn only (the ends of a shelf) is told apart.
Source: Lowe, IJCV 60(2), 2004; square root of the L1-normalised descriptor: Arandjelovic and Zisserman, CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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
LAYERS = 3  # per octave, OpenCV's default
LEAST_SIDE_PX = 11  # SIFT takes nothing within 5 pixels of the border, and OpenCV's fails at sides of 2
LARGE_WIDTH_PX = 500  # from here on an image is described at half its size; docs/localisation.md has the comparison
# Root of a share of the L1 norm, times this: a unit vector of length 512 whose entries rarely reach 255.
BYTE_SCALE = 512.0


@dataclass(frozen=True, slots=True)
class Look:
    """How an image is searched."""

    contrast: float  # of what is looked for
    detail_contrast: float  # of what a map takes besides: its landmarks need not be recognised by themselves
    edge_ratio: float  # a corner on a stronger edge than this is left out: it may slide along
    is_evened: bool  # local contrast is made about the same all over the image first


FIRST_LOOK = Look(contrast=0.02, detail_contrast=0.01, edge_ratio=10.0, is_evened=False)
# Painted walls and plain furniture show faint corners and the ends of edges, often in the shade.
SECOND_LOOK = Look(contrast=0.03, detail_contrast=0.015, edge_ratio=20.0, is_evened=True)
FEW_FEATURES = 300  # fewer at the first look: of such images far fewer are recognised, so they are looked at again
EVENED_TILES = (8, 6)
EVENED_CLIP = 4.0  # of a tile's histogram: limits how far noise is amplified


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
    """Detects and describes. Holds the library's detectors, so one per thread."""

    def __init__(self, max_features: int = MAX_FEATURES, *, up_deg: float | None = None) -> None:
        """`up_deg`: which way is up in the images (`Calibration.up_in_image_deg`); None: any way."""
        self._first = _Finder(FIRST_LOOK, FIRST_LOOK.contrast, max_features, up_deg)
        self._second = _Finder(SECOND_LOOK, SECOND_LOOK.contrast, max_features, up_deg)

    def extract(self, grey: ImageArray) -> Features:
        """Features of an image (H, W); none on a featureless one."""
        found, _ = self._first.find(grey)
        return found if len(found) >= FEW_FEATURES else self._second.find(grey)[0]


class DetailExtractor:
    """The same for a map: one look gives what localisation sees in an image, and what else landmarks come from."""

    def __init__(self, up_deg: float | None = None) -> None:
        limit = 2 * MAX_DETAILS  # some are found twice
        self._first = _Finder(FIRST_LOOK, FIRST_LOOK.detail_contrast, limit, up_deg)
        self._second = _Finder(SECOND_LOOK, SECOND_LOOK.detail_contrast, limit, up_deg)

    def extract(self, grey: ImageArray) -> Details:
        details = _details(self._first, grey)
        return details if len(details.seen) >= FEW_FEATURES else _details(self._second, grey)


class _Finder:
    """One look at images."""

    def __init__(self, look: Look, contrast: float, max_features: int, up_deg: float | None) -> None:
        self.look = look
        self._up_deg, self._max_features = up_deg, max_features
        # Without "precise", features lie a quarter of a pixel too far right and down (blobs at known places).
        limit = max_features if up_deg is None else 0  # a corner of a pattern is found up to four times: cut after that
        self._sift = cv2.SIFT.create(limit, LAYERS, contrast, look.edge_ratio, enable_precise_upscale=True)
        self._evened = cv2.createCLAHE(EVENED_CLIP, EVENED_TILES) if look.is_evened else None

    def find(self, grey: ImageArray) -> tuple[Features, Float32Array]:
        """Features of an image (H, W), responses (n,): contrast over LAYERS. Their order depends on them only."""
        # SIFT doubles an image before it looks for details: of a large one, that octave is noise and costs most.
        scale = 0.5 if grey.shape[1] >= LARGE_WIDTH_PX else 1.0
        seen = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if self._evened is not None:
            seen = self._evened.apply(seen)
        keypoints, raw = self._described(seen) if min(seen.shape) >= LEAST_SIDE_PX else ((), None)
        if raw is None or not len(keypoints):
            return Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.uint8)), np.zeros(0, dtype=np.float32)
        uv = (np.array([k.pt for k in keypoints], dtype=np.float64) + 0.5) / scale - 0.5  # pixels' centres stay centres
        response = np.array([k.response for k in keypoints], dtype=np.float32)
        angle = np.array([k.angle for k in keypoints])
        order = np.lexsort((angle, uv[:, 1], uv[:, 0], -response))
        return Features(uv[order], to_bytes(np.asarray(raw, dtype=np.float32)[order])), response[order]

    def _described(self, seen: npt.NDArray[Any]) -> tuple[Sequence[cv2.KeyPoint], npt.NDArray[Any] | None]:
        if self._up_deg is None:
            return self._sift.detectAndCompute(seen, None)
        # A corner that was found twice, turned two ways, is one.
        upright = list({(k.pt, k.size): k for k in self._sift.detect(seen, None)}.values())
        if len(upright) > self._max_features:  # as OpenCV has it: those as strong as the last one are taken, too
            least = sorted((k.response for k in upright), reverse=True)[self._max_features - 1]
            upright = [k for k in upright if k.response >= least]
        for keypoint in upright:
            keypoint.angle = self._up_deg
        return self._sift.compute(seen, upright)


def _details(finder: _Finder, grey: ImageArray) -> Details:
    found, response = finder.find(grey)
    count = int(np.count_nonzero(response * np.float32(LAYERS) >= np.float32(finder.look.contrast)))
    if count > MAX_FEATURES:  # as a FeatureExtractor has it
        count = int(np.count_nonzero(response >= response[MAX_FEATURES - 1]))
    # A corner that was described twice, turned two ways, would become two landmarks.
    _, first = np.unique(found.uv_px, axis=0, return_index=True)
    rows = np.sort(first)[:MAX_DETAILS]
    seen = Features(found.uv_px[:count].copy(), found.descriptors[:count].copy())  # not the whole, kept alive
    return Details(seen, Features(found.uv_px[rows], found.descriptors[rows]))


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
