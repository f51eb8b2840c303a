"""Loop closure: what the odometry cannot have drifted by is a look-alike."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, se3
from station.slam.mapping.config import MatchConfig
from station.slam.mapping.loops import MIN_APART, find_loops
from station.slam.mapping.odometry import DEAD_RECKONED, MOTION_START, Drift
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.tracks import Tracks
from station.vision.features import Features

FOCAL_PX = 500.0
R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along body x
SURE = Drift(position_m=0.15, position_per_way=0.02, rotation_rad=0.09)


def seen_from(points: FloatArray, p_camera: FloatArray) -> FloatArray:
    """(n, 2) normalised coordinates of points (n, 3) for a camera that looks along x."""
    p = (points - p_camera) @ R_BODY_CAM
    return np.asarray(p[:, :2] / p[:, 2:])


def loops_of(shift_m: float, drift: Drift) -> int:
    """How many loops close on a way of 12 m out and back, where the chair seen at its end stands `shift_m` aside."""
    rng = np.random.default_rng(3)
    chair = np.array([8.0, 0.0, 0.3]) + rng.uniform(-0.5, 0.5, (40, 3))
    sift = rng.integers(0, 256, (40, 128), dtype=np.uint8)
    nothing = Features(np.empty((0, 2)), np.empty((0, 128), np.uint8))
    x = np.concatenate([[0.0, 0.3], np.linspace(0.5, 6.0, MIN_APART), np.linspace(5.0, 0.0, MIN_APART)])
    n = len(x)
    p_body = np.column_stack([x, np.zeros(n), np.zeros(n)])
    p_body[2:-1, 1] = 3.0  # elsewhere
    R = np.tile(np.eye(3), (n, 1, 1))
    rays = [np.empty((0, 2)) for _ in range(n)]
    features = [nothing] * n
    for k in (0, 1, n - 1):
        moved = chair + ([0.0, shift_m, 0.0] if k == n - 1 else [0.0, 0.0, 0.0])
        rays[k] = seen_from(moved, p_body[k])
        uv = FOCAL_PX * rays[k]
        features[k] = Features(uv, sift)
    tracks = Tracks(np.repeat([0, 1], 40), np.tile(np.arange(40), 2), np.tile(np.arange(40), 2), 40)
    state = BundleState(R, p_body, chair, MOTION_START)
    found = find_loops(features, rays, state, tracks, se3(R_BODY_CAM, np.zeros(3)), FOCAL_PX, drift, MatchConfig())
    assert all(b == n - 1 for _, b, _ in found)
    return len(found)


@pytest.mark.parametrize(
    ("shift_m", "by_wheels", "by_filter"), [(0.05, True, True), (0.8, True, False), (2.5, False, False)]
)
def test_a_loop_closes_where_the_odometry_may_have_drifted_so_far(
    shift_m: float, by_wheels: bool, by_filter: bool
) -> None:
    assert (loops_of(shift_m, DEAD_RECKONED) > 0) == by_wheels
    assert (loops_of(shift_m, SURE) > 0) == by_filter
