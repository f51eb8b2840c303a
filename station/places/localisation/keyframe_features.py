"""What a map's keyframes look like: features, and for those that lie on a landmark, its position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray, homogeneous
from station.model.place_map import PlaceMap
from station.vision.features import DescriptorArray, Features, to_rays

LANDMARK_ANGLE_RAD = np.radians(35.0)  # seen from farther aside, a landmark does not look as it was described
ON_LANDMARK_PX = 2.0  # two detectors agree on a corner to about a pixel
NEAR_LANDMARK_PX = 30.0  # a surface is smooth that far, or its landmarks disagree in depth
MIN_ON_LANDMARK = 120  # fewer: depths are borrowed from neighbouring landmarks
DEPTH_AGREEMENT = 0.04  # relative spread of neighbouring depths that still is one surface


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeFeatures:
    """Features of one keyframe that have a position in the map."""

    descriptors: DescriptorArray  # (n, 128)
    p_map: FloatArray  # (n, 3)
    landmark: IntArray  # (n,) index into the map's landmarks; the nearest one where the depth was borrowed
    all_descriptors: DescriptorArray  # (m, 128) also those without position: they make the appearance


def describe_keyframes(
    place_map: PlaceMap, describe: Callable[[bytes], Features], on_keyframe: Callable[[], None] = lambda: None
) -> list[KeyframeFeatures]:
    """Features of every keyframe; an image that cannot be decoded, or is missing, has none.

    `describe` finds them in an encoded image; `on_keyframe` is called before each.
    """
    navigation = place_map.navigation
    landmarks, keyframes = navigation.landmarks, navigation.keyframes
    camera = navigation.calibration.camera
    out = []
    for k, observed in enumerate(landmarks.observations_by_keyframe(len(keyframes))):
        on_keyframe()
        features = describe(keyframes.encoded[k])
        if camera is None or not len(observed) or not len(features):
            out.append(_nothing(features))
            continue
        ids = landmarks.observed_landmark[observed]
        out.append(
            _place_features(
                features, camera, keyframes.T_world_cam[k], landmarks.observed_uv_px[observed], ids, landmarks.p_world
            )
        )
    return out


def _nothing(features: Features) -> KeyframeFeatures:
    empty = np.zeros((0, 128), dtype=np.uint8)
    return KeyframeFeatures(empty, np.zeros((0, 3)), np.zeros(0, dtype=np.int64), features.descriptors)


def _place_features(
    features: Features,
    camera: CameraCalibration,
    T_world_cam: FloatArray,
    observed_uv: FloatArray,
    ids: IntArray,
    p_world: FloatArray,
) -> KeyframeFeatures:
    distance, nearest = cKDTree(observed_uv).query(features.uv_px)
    on = distance <= ON_LANDMARK_PX
    p = np.full((len(features), 3), np.nan)
    p[on] = p_world[ids[nearest[on]]]
    if np.count_nonzero(on) < MIN_ON_LANDMARK:
        off = np.flatnonzero(~on & (distance <= NEAR_LANDMARK_PX))
        p[off] = _borrow_depth(features.uv_px[off], camera, T_world_cam, observed_uv, p_world[ids])
    has = np.isfinite(p).all(axis=1)
    return KeyframeFeatures(features.descriptors[has], p[has], ids[nearest[has]], features.descriptors)


def _borrow_depth(
    uv: FloatArray, camera: CameraCalibration, T_world_cam: FloatArray, observed_uv: FloatArray, p_observed: FloatArray
) -> FloatArray:
    """Points (n, 3) on the rays of pixels (n, 2), as deep as the landmarks around; NaN where those disagree.

    The inverse depth of a plane is affine in the image, so it is what is averaged.
    """
    out = np.full((len(uv), 3), np.nan)
    if len(uv) == 0 or len(observed_uv) < 4:
        return out
    R, t = T_world_cam[:3, :3], T_world_cam[:3, 3]
    inverse_depth = 1.0 / np.maximum(((p_observed - t) @ R)[:, 2], 1e-6)
    distance, index = cKDTree(observed_uv).query(uv, k=4, distance_upper_bound=NEAR_LANDMARK_PX)
    near = np.isfinite(distance)
    index = np.where(near, index, 0)
    weight = near / (distance + 2.0) if near.all() else np.where(near, 1.0 / (np.where(near, distance, 0.0) + 2.0), 0.0)
    total = np.maximum(weight.sum(axis=1), 1e-12)
    mean = (weight * inverse_depth[index]).sum(axis=1) / total
    spread = np.sqrt((weight * (inverse_depth[index] - mean[:, None]) ** 2).sum(axis=1) / total)
    good = (near.sum(axis=1) >= 3) & (spread < DEPTH_AGREEMENT * mean) & (mean > 0)
    rays = homogeneous(to_rays(camera, uv))
    out[good] = (rays[good] / mean[good, None]) @ R.T + t
    return out
