"""Loop closure for a navigation whose poses are nearly right: look where two keyframes should see the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.geometry import FloatArray, so3_log
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
    landmark_of = [np.full(len(f), -1, dtype=np.int64) for f in features]
    for k, m, f in zip(tracks.keyframe.tolist(), tracks.point.tolist(), tracks.feature.tolist(), strict=True):
        landmark_of[k][f] = m
    out: list[Pairs] = []
    for a, b in candidates(R_cam, centre, config.loops_per_keyframe):
        pairs = match_both_ways(similarities(features[a], features[b]), config.max_ratio)
        known = landmark_of[a][pairs[:, 0]] >= 0 if len(pairs) else np.empty(0, dtype=bool)
        pairs = pairs[known]
        if len(pairs) < config.min_loop_inliers:
            continue
        points = state.points[landmark_of[a][pairs[:, 0]]]
        found = pose_by_ransac(
            points, rays[b][pairs[:, 1]], PNP_ERROR_PX / focal_px, PNP_ITERATIONS, config.seed_of_pnp
        )
        if found is None:
            continue
        T_world_cam, inliers = found
        turned = float(np.linalg.norm(so3_log(R_cam[b].T @ T_world_cam[:3, :3])))
        moved = float(np.linalg.norm(T_world_cam[:3, 3] - centre[b]))
        is_explained = drift.explains(moved, turned, float(abs(way[b] - way[a])))
        if is_explained and len(inliers) >= config.min_loop_inliers:
            out.append((a, b, pairs[inliers]))
    return out


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
