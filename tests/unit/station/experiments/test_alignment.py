"""Alignment recovers known motions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, carry_poses, se3, sim3, so3_exp, so3_log, transform, yaw_rotation
from station.experiments.alignment import align_most_points, align_points, align_poses


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 1000), scale=st.floats(0.05, 20))
def test_known_motion_is_recovered(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points, R, t = rng.normal(size=(12, 3)), so3_exp(rng.normal(size=3)), rng.normal(size=3)
    similar = align_points(scale * points @ R.T + t, points, "sim3")
    assert similar.scale == pytest.approx(scale) and similar.rms < 1e-9 * max(scale, 1)
    np.testing.assert_allclose(similar.R_target_source, R, atol=1e-9)
    np.testing.assert_allclose(align_points(points @ R.T + t, points, "se3").T_target_source, se3(R, t), atol=1e-9)
    Rz = yaw_rotation(float(rng.uniform(-3, 3)))
    yaw = align_points(points @ Rz.T + t, points, "yaw")
    np.testing.assert_allclose(yaw.T_target_source, se3(Rz, t), atol=1e-9)


def test_mirrored_points_are_not_matched_by_a_mirror() -> None:
    points = np.random.default_rng(0).normal(size=(10, 3))
    alignment = align_points(points * [1, 1, -1], points)
    assert np.linalg.det(alignment.R_target_source) == pytest.approx(1.0) and alignment.rms > 0.1


def test_points_that_leave_a_rotation_open_are_refused() -> None:
    line = np.outer(np.arange(5.0), [1, 0, 0])
    vertical = np.outer(np.arange(5.0), [0, 0, 1])
    with pytest.raises(DegenerateGeometry):
        align_points(line, line)
    with pytest.raises(DegenerateGeometry):
        align_points(vertical, vertical, "yaw")
    with pytest.raises(DegenerateGeometry):
        align_points(line[:1], line[:1])


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), scale=st.floats(0.05, 20))
def test_known_motion_is_recovered_though_four_in_ten_points_are_wrong(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points, T = rng.normal(size=(20, 3)), sim3(scale, so3_exp(rng.normal(size=3)), rng.normal(size=3))
    target = transform(T, points)
    target[:8] += scale * rng.normal(0, 5, (8, 3))
    np.testing.assert_allclose(align_most_points(target, points).T_target_source, T, atol=1e-6 * scale)


def test_most_points_of_too_few_or_of_a_line_are_no_answer() -> None:
    for points in (np.eye(3), np.outer(np.arange(9.0), [1, 2, 3])):
        with pytest.raises(DegenerateGeometry):
            align_most_points(points, points)


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 1000), scale=st.floats(0.05, 20))
def test_known_motion_of_poses_is_recovered_from_a_straight_path_too(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    T = sim3(scale, so3_exp(rng.normal(size=3)), rng.normal(size=3))
    straight = np.array([se3(so3_exp(rng.normal(size=3)), x * np.array([1.0, 2.0, 3.0])) for x in range(6)])
    found = align_poses(carry_poses(T, straight), straight, 1.0)
    np.testing.assert_allclose(found.T_target_source, T, atol=1e-6 * (1 + scale))
    assert found.scale == pytest.approx(scale) and found.rms < 1e-6 * (1 + scale)


def test_orientations_mend_the_rotation_of_a_short_path() -> None:
    """Positions good to 2 cm over a path of some decimetres turn the world by degrees."""
    rng = np.random.default_rng(2)
    truth = np.array([se3(so3_exp(rng.normal(size=3)), p) for p in rng.normal(0, 0.1, (30, 3))])
    seen = truth.copy()
    seen[:, :3, 3] += rng.normal(0, 0.02, (30, 3))
    seen[:, :3, :3] = seen[:, :3, :3] @ so3_exp(rng.normal(0, 0.01, (30, 3)))

    def tilt(R: FloatArray) -> float:
        return float(np.linalg.norm(so3_log(R)))

    by_positions = align_points(seen[:, :3, 3], truth[:, :3, 3], "sim3")
    assert tilt(align_poses(seen, truth, 1.0).R_target_source) < 0.2 * tilt(by_positions.R_target_source)


def test_poses_that_leave_the_scale_open_are_refused() -> None:
    still = np.array([se3(so3_exp(np.array([0.1 * k, 0, 0])), np.ones(3)) for k in range(5)])
    for poses in (still, still[:1]):
        with pytest.raises(DegenerateGeometry):
            align_poses(poses, poses, 1.0)
