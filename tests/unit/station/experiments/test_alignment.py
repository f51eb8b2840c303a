"""Alignment recovers known motions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import DegenerateGeometry
from shared.geometry import se3, so3_exp, yaw_rotation
from station.experiments.alignment import align_points


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 1000), scale=st.floats(0.05, 20))
def test_known_motion_is_recovered(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points, R, t = rng.normal(size=(12, 3)), so3_exp(rng.normal(size=3)), rng.normal(size=3)
    sim3 = align_points(scale * points @ R.T + t, points, "sim3")
    assert sim3.scale == pytest.approx(scale) and sim3.rms < 1e-9 * max(scale, 1)
    np.testing.assert_allclose(sim3.R_target_source, R, atol=1e-9)
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
