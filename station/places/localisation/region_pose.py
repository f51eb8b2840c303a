"""The camera's pose from keyframes that look at one region of a map: matches, RANSAC, matches guided by the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from shared.calibration import CameraCalibration
from shared.geometry import FloatArray, IntArray, inverse, median_radius, transform
from station.places.localisation.keyframe_features import KeyframeFeatures
from station.vision.camera_pose import CameraPose, solve_pose, solve_pose_from
from station.vision.features import Features, Float32Array, to_floats
from station.vision.matching import clearly_nearest

MIN_MATCHES = 6  # fewer agree on a pose by chance


@dataclass(frozen=True, slots=True)
class MatchingConfig:
    """Thresholds; pixels are of the query image."""

    ratio: float = 0.85  # nearest descriptor against the nearest of another landmark
    min_similarity: float = 0.75  # of RootSIFT descriptors, 0..1
    pixel_tolerance: float = 4.0
    guided_radius_px: float = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class FoundPose:
    """A pose and the matches it rests on."""

    pose: CameraPose
    map_index: int
    query: IntArray  # (i,) feature numbers of the inliers
    landmark: IntArray  # (i,) their landmarks
    num_matches: int
    extent: float  # map units


def find_pose(
    map_index: int,
    keyframes: Sequence[KeyframeFeatures],
    features: Features,
    rays: FloatArray,
    camera: CameraCalibration,
    c: MatchingConfig,
) -> FoundPose | None:
    """The pose that most matches with the keyframes of one region of a map agree on.

    Args:
        features: of the image.
        rays: (n, 2) normalised coordinates of the features.
    """
    keyframes = [k for k in keyframes if len(k.landmark)]
    if not keyframes:
        return None
    p_map = np.concatenate([k.p_map for k in keyframes])
    landmark = np.concatenate([k.landmark for k in keyframes])
    descriptors = np.concatenate([k.descriptors for k in keyframes])
    similarity = to_floats(features.descriptors) @ to_floats(descriptors).T
    # The second nearest must be of another landmark, and not the same spot in another keyframe.
    query, found = clearly_nearest(similarity, c.ratio, owner=landmark)
    alike = similarity[query, found] > c.min_similarity
    query, found = query[alike], found[alike]
    if len(query) < MIN_MATCHES:
        return None
    tolerance = c.pixel_tolerance / camera.fx
    first = solve_pose(p_map[found], rays[query], tolerance)
    if first is None or first.num_inliers < MIN_MATCHES:
        return None
    query, found = _match_guided(first, rays, p_map, similarity, c.guided_radius_px / camera.fx, c.min_similarity)
    if len(query) < MIN_MATCHES:
        return None
    pose = solve_pose_from(first.T_map_cam, p_map[found], rays[query], tolerance)
    if pose is None:
        return None
    inlier = np.flatnonzero(pose.inlier)
    _, first_of_each = np.unique(landmark[found[inlier]], return_index=True)
    return FoundPose(
        pose=pose,
        map_index=map_index,
        query=query[inlier],
        landmark=landmark[found[inlier]],
        num_matches=len(query),
        extent=median_radius(p_map[found[inlier[first_of_each]]]),
    )


def _match_guided(
    pose: CameraPose,
    rays: FloatArray,
    p_map: FloatArray,
    similarity: Float32Array,
    radius: float,
    min_similarity: float,
) -> tuple[IntArray, IntArray]:
    """Matches between features and map points that the pose projects near them: the best row per feature."""
    T_cam_map = inverse(pose.T_map_cam)
    p_cam = transform(T_cam_map, p_map)
    ahead = np.flatnonzero(p_cam[:, 2] > 1e-6)
    if not len(ahead):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    xy = p_cam[ahead, :2] / p_cam[ahead, 2:]
    near = cKDTree(rays).query_ball_tree(cKDTree(xy), radius)
    count = np.fromiter(map(len, near), np.int64, len(near))
    query = np.flatnonzero(count)
    if not len(query):
        return query, query
    rows = ahead[np.fromiter(chain.from_iterable(near), np.int64, int(count.sum()))]
    alike = similarity[np.repeat(np.arange(len(near)), count), rows]
    begin = np.cumsum(count[query]) - count[query]
    best = np.maximum.reduceat(alike, begin)
    is_best = np.flatnonzero(alike == np.repeat(best, count[query]))
    found = rows[is_best[np.searchsorted(is_best, begin)]]  # of equals the first one
    good = best > min_similarity
    return query[good], found[good]
