"""Loop closure for a navigation whose poses are nearly right: look where two keyframes should see the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, se3, so3_log
from station.slam.mapping.config import MatchConfig
from station.slam.mapping.odometry import Drift
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.tracks import Pairs, Tracks
from station.vision.camera_pose import pose_by_ransac
from station.vision.features import Features, similarities
from station.vision.matching import match_both_ways

MIN_APART = 8  # keyframes nearer in time have been matched already
MAX_ANGLE_RAD = 0.5  # between viewing directions: beyond it SIFT and a narrow view share nothing
MAX_DISTANCE_M = 2.0
PNP_ERROR_PX, PNP_ITERATIONS = 5.0, 200


def find_loops(
    features: Sequence[Features],
    rays: Sequence[FloatArray],
    state: BundleState,
    tracks: Tracks,
    T_body_cam: FloatArray,
    focal_px: float,
    drift: Drift,
    config: MatchConfig,
) -> list[Pairs]:
    """Matches between keyframes far apart in time, each confirmed by a pose from landmarks that `drift` explains."""
    R_cam = state.R_world_body @ T_body_cam[:3, :3]
    centre = state.p_world_body + state.R_world_body @ T_body_cam[:3, 3]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    landmark_of = landmarks_shown(tracks, [len(f) for f in features])
    out: list[Pairs] = []
    for a, b in candidates(R_cam, centre, config.loops_per_keyframe):
        expected = se3(R_cam[b], centre[b])
        seen = Seen(features[a], landmark_of[a], state.points)
        found = recognise(seen, features[b], rays[b], expected, abs(way[b] - way[a]), focal_px, drift, config)
        if found is not None:
            out.append((a, b, found.pairs))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What an older keyframe shows."""

    features: Features
    landmark: IntArray  # (n,) of each feature; -1: of none
    points: FloatArray  # (M, 3) of the landmarks, in the world


@dataclass(frozen=True, slots=True, eq=False)
class Recognised:
    """What two keyframes far apart in time both show, and where the newer one's camera was by that."""

    pairs: IntArray  # (n, 2) features of the older and of the newer one
    T_world_cam: FloatArray  # (4, 4)
    landmark: IntArray  # (n,) what they show, rows of Seen.points


def recognise(
    old: Seen,
    features: Features,
    rays: FloatArray,
    T_world_cam: FloatArray,
    way_m: float,
    focal_px: float,
    drift: Drift,
    config: MatchConfig,
) -> Recognised | None:
    """Match two keyframes; None unless a pose from landmarks (PnP) confirms it that `drift` explains.

    Args:
        features, rays: of the newer keyframe.
        T_world_cam: (4, 4) where it is expected; way_m: over which that may have drifted.
    """
    pairs = match_both_ways(similarities(old.features, features), config.max_ratio)
    pairs = pairs[old.landmark[pairs[:, 0]] >= 0]
    if len(pairs) < config.min_loop_inliers:
        return None
    landmark = old.landmark[pairs[:, 0]]
    points = old.points[landmark]
    found = pose_by_ransac(points, rays[pairs[:, 1]], PNP_ERROR_PX / focal_px, PNP_ITERATIONS, config.seed_of_pnp)
    if found is None or len(found[1]) < config.min_loop_inliers:
        return None
    T_found, inliers = found
    if not drift.explains(*apart(T_world_cam, T_found), way_m):
        return None
    return Recognised(pairs[inliers], T_found, landmark[inliers])


def apart(T_a: FloatArray, T_b: FloatArray) -> tuple[float, float]:
    """By how much two poses differ: m, rad."""
    turned = so3_log(T_a[:3, :3].T @ T_b[:3, :3])
    return float(np.linalg.norm(T_b[:3, 3] - T_a[:3, 3])), float(np.linalg.norm(turned))


def landmarks_shown(tracks: Tracks, num_features: Sequence[int]) -> list[IntArray]:
    """Of each keyframe the landmark (n,) that each of its features shows; -1: none."""
    first = np.concatenate([[0], np.cumsum(num_features)])
    shown = np.full(first[-1], -1, dtype=np.int64)
    shown[first[tracks.keyframe] + tracks.feature] = tracks.point
    return np.split(shown, first[1:-1])


def candidates(R_world_cam: FloatArray, centre: FloatArray, per_keyframe: int) -> list[tuple[int, int]]:
    """Pairs a < b, far apart in time, that by their poses should see the same: the best few of each b."""
    forward = R_world_cam[:, :, 2]
    out: list[tuple[int, int]] = []
    for b in range(MIN_APART, len(centre)):
        older = np.arange(b - MIN_APART + 1)
        angle = np.arccos(np.clip(forward[older] @ forward[b], -1.0, 1.0))
        distance = np.linalg.norm(centre[older] - centre[b], axis=1)
        score = angle / MAX_ANGLE_RAD + distance / MAX_DISTANCE_M
        chosen: list[int] = []
        for a in older[np.argsort(score, kind="stable")].tolist():
            if score[a] > 1.0 or len(chosen) == per_keyframe:
                break
            if all(abs(a - other) > 2 for other in chosen):
                chosen.append(a)
        out.extend((a, b) for a in chosen)
    return out
