"""Where a turned head has its camera."""

import numpy as np

from shared.calibration import REFERENCE_CAMERA, REFERENCE_HEAD
from shared.geometry import inverse, transform
from shared.head import turned

AXIS = REFERENCE_CAMERA.T_body_cam_matrix[:3, 2]


def optical_axis(pan: float, tilt: float) -> np.ndarray:
    return np.asarray((turned(REFERENCE_HEAD, pan, tilt) @ REFERENCE_CAMERA.T_body_cam_matrix)[:3, 2])


def test_a_head_that_looks_ahead_changes_no_bit() -> None:
    T = REFERENCE_CAMERA.T_body_cam_matrix
    assert (turned(REFERENCE_HEAD, 0.0, 0.0) == np.eye(4)).all() and (turned(REFERENCE_HEAD, 0.0, 0.0) @ T == T).all()


def test_pan_is_to_the_left_and_tilt_up() -> None:
    assert optical_axis(0.5, 0.0)[1] > AXIS[1] + 0.4 and optical_axis(0.0, 0.5)[2] > AXIS[2] + 0.4
    both = optical_axis(0.5, 0.5)
    assert np.arctan2(both[1], both[0]) > 0.45 and both[2] > 0.45  # tilted about the panned axis


def test_the_pivot_stays_and_the_motion_is_rigid() -> None:
    T, pivot = turned(REFERENCE_HEAD, 0.7, -0.3), np.array([REFERENCE_HEAD.pivot_body])
    np.testing.assert_allclose(transform(T, pivot), pivot, atol=1e-15)
    np.testing.assert_allclose(T @ inverse(T), np.eye(4), atol=1e-15)
