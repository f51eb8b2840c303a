"""Laws of registration and camera poses: known motions come back, whatever they are."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import inverse, inverse_sim3, se3, so3_exp, transform, yaw_rotation
from station.places.registration.register import register_clouds
from station.vision.camera_pose import solve_pose
from tests.support.registration_clouds import make_pair

CLOUD = make_pair(9201, overlap=(1.0, 1.0), points=(2000, 2001), outliers=(0.0, 0.0), noise_m=0.0).target


@settings(max_examples=4, deadline=None)
@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-50, 50), y=st.floats(-50, 50), z=st.floats(-3, 3))
def test_any_yaw_and_translation_of_a_cloud_is_recovered(yaw: float, x: float, y: float, z: float) -> None:
    T = se3(yaw_rotation(yaw), np.array([x, y, z]))
    result = register_clouds(CLOUD, transform(inverse(T), CLOUD))
    assert result.accepted, result.reasons
    assert result.T_target_source is not None
    assert np.allclose(transform(result.T_target_source @ inverse(T), CLOUD), CLOUD, atol=2e-3)


@settings(max_examples=2, deadline=None)
@given(scale=st.floats(0.82, 1.2), yaw=st.floats(-3.1, 3.1))
def test_any_scale_in_range_is_recovered(scale: float, yaw: float) -> None:
    T = se3(scale * yaw_rotation(yaw), np.array([1.0, 2.0, 0.1]))
    result = register_clouds(CLOUD, transform(inverse_sim3(T), CLOUD), scale="free")
    assert result.accepted, result.reasons
    assert abs(result.scale / scale - 1) < 2e-3


VECTOR = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@settings(max_examples=40, deadline=None)
@given(phi=VECTOR, t=VECTOR, seed=st.integers(0, 1000))
def test_a_camera_pose_comes_back_from_its_projections_despite_outliers(
    phi: np.ndarray, t: np.ndarray, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    T_map_cam = se3(so3_exp(phi), t)
    p_cam = rng.uniform([-1, -1, 2], [1, 1, 5], (40, 3))
    rays = p_cam[:, :2] / p_cam[:, 2:]
    rays[:8] += rng.uniform(0.1, 0.5, (8, 2))
    pose = solve_pose(transform(T_map_cam, p_cam), rays, 0.005)
    assert pose is not None
    assert np.allclose(pose.T_map_cam, T_map_cam, atol=1e-5)
    assert not pose.inlier[:8].any() and pose.inlier[8:].all()
