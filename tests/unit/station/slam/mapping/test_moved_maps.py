"""A map of some of its keyframes, and one whose keyframes were moved."""

from __future__ import annotations

import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray, inverse, se3, transform
from station.slam.mapping.inertial_mapping import among, moved_to
from station.slam.mapping.odometry import MOTION_START
from station.slam.mapping.odometry_bundle import BundleState
from station.slam.mapping.odometry_mapping import OdometryMap
from station.slam.mapping.tracks import Tracks

NUM_POINTS = 30


def seen(T_world_body: FloatArray, points: FloatArray) -> FloatArray:
    p = transform(inverse(T_world_body @ REFERENCE_CAMERA.T_body_cam_matrix), points)
    return p[:, :2] / p[:, 2:]


@pytest.fixture
def made() -> OdometryMap:
    """Four poses side by side, which all see the same points two to four metres before them."""
    rng = np.random.default_rng(0)
    points = rng.uniform([2.0, -0.8, -0.5], [4.0, 0.8, 0.5], (NUM_POINTS, 3))
    T = np.array([se3(np.eye(3), np.array([0.0, 0.15 * k, 0.0])) for k in range(4)])
    each = np.tile(np.arange(NUM_POINTS), 4)
    tracks = Tracks(np.repeat(np.arange(4), NUM_POINTS), each, each, NUM_POINTS)
    state = BundleState(T[:, :3, :3], T[:, :3, 3], points, MOTION_START)
    rays = [seen(one, points) for one in T]
    return OdometryMap(state, tracks, rays, 1, 3, 0.5, np.zeros((NUM_POINTS, 3, 3)))


def test_some_keyframes_of_a_map_see_what_they_saw(made: OdometryMap) -> None:
    few = among(made, [0, 2, 3])
    assert few.tracks.keyframe.max() == 2 and few.tracks.num_points == NUM_POINTS
    for k, T in enumerate(se3_of(few)):
        mine = few.tracks.keyframe == k
        rays = few.rays[k][few.tracks.feature[mine]]
        np.testing.assert_allclose(seen(T, few.state.points[few.tracks.point[mine]]), rays, atol=1e-9)


def test_what_moved_keyframes_see_moves_with_them(made: OdometryMap) -> None:
    larger = se3_of(made)
    larger[:, :3, 3] *= 1.1
    # The camera sits before the body's origin, so that its own arm does not grow.
    arm = REFERENCE_CAMERA.T_body_cam_matrix[:3, 3]
    moved = moved_to(made, larger, REFERENCE_CAMERA)
    np.testing.assert_allclose(moved.state.points, 1.1 * (made.state.points - arm) + arm, atol=1e-6)
    assert moved.num_loops == made.num_loops


def se3_of(made: OdometryMap) -> FloatArray:
    return np.array([se3(R, p) for R, p in zip(made.state.R_world_body, made.state.p_world_body, strict=True)])
