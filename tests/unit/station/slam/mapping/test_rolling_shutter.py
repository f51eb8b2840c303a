"""What rows exposed later saw, moved back to the image's time."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray, so3_exp
from station.slam.mapping.odometry import MOTION_START
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.odometry_mapping import stood_still
from station.slam.mapping.rolling_shutter import RowMotion, moved_back, observation_pose
from station.slam.mapping.tracks import Tracks


def seen_from(R: FloatArray, x: FloatArray, points: FloatArray) -> FloatArray:
    p = np.einsum("...ji,...j->...i", R, points - x)
    return p[..., :2] / p[..., 2:]


@given(st.integers(0, 10_000))
def test_a_moving_camera_is_moved_back_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-1, 1, (30, 2)), rng.uniform(1.5, 5.0, 30)])
    v, delay_s = rng.normal(0, 0.5, 3), rng.uniform(-0.01, 0.01, 30)
    R, x = observation_pose(np.eye(3), np.zeros(3), v, np.zeros(3), delay_s)
    xy = seen_from(R, x, points)
    back = moved_back(xy, points[:, 2], delay_s, np.broadcast_to(v, (30, 3)))
    assert np.allclose(back, seen_from(np.eye(3), np.zeros(3), points), atol=1e-12)


def test_only_rays_of_landmarks_are_moved_and_by_their_own_depth() -> None:
    rng = np.random.default_rng(1)
    T = REFERENCE_CAMERA.T_body_cam_matrix
    R = np.array([so3_exp(rng.normal(0, 0.2, 3)) for _ in range(3)])
    p = rng.normal(0, 0.3, (3, 3))
    R_cam, centre = R @ T[:3, :3], p + R @ T[:3, 3]
    points = centre[0] + np.array([[-0.3, 0.1, 1.0], [0.2, 0.2, 3.0]]) @ R_cam[0].T
    v_cam, delay_s = np.array([[0.4, 0.0, 0.1], [0.0, 0.3, 0.0], [0.1, 0.0, 0.5]]), np.array([0.005, -0.004, 0.006])
    at_once, rows = [], []
    for view in range(3):
        xy = np.array([seen_from(R_cam[view], centre[view], points[i]) for i in (0, 1)])
        at_once.append(np.vstack([xy, [[0.1, 0.1]]]))  # the third feature is of no landmark
        rows.append(RowMotion(delay_s, v_cam[view], np.zeros(3)))
    rays = [xy.copy() for xy in at_once]
    for view in range(3):
        for i in (0, 1):
            later = centre[view] + R_cam[view] @ v_cam[view] * delay_s[i]
            rays[view][i] = seen_from(R_cam[view], later, points[i])
    feature = np.tile([0, 1], 3)
    tracks = Tracks(np.repeat(np.arange(3), 2), feature, feature, 2)
    state = BundleState(R, p, points, MOTION_START)
    for moved, right in zip(stood_still(rays, rows, state, tracks, REFERENCE_CAMERA), at_once, strict=True):
        assert np.allclose(moved, right, atol=1e-12)
    assert stood_still(rays, None, state, tracks, REFERENCE_CAMERA) is rays
