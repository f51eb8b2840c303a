"""How a robot is really built, where its calibration tells other numbers."""

from __future__ import annotations

import msgspec
import numpy as np

from robot.simulation.config import BuildErrors
from shared.calibration import CameraCalibration
from shared.geometry import se3, so3_exp


def built_camera(told: CameraCalibration, errors: BuildErrors) -> CameraCalibration:
    """The camera that takes the pictures and stamps them, for one whose calibration tells `told`."""
    stretch = 1.0 + errors.focal_percent / 100
    turn = so3_exp(np.radians([errors.pitch_deg, 0.0, 0.0])) @ so3_exp(np.radians([0.0, errors.yaw_deg, 0.0]))
    T_body_cam = told.T_body_cam_matrix @ se3(turn, np.zeros(3))
    T_body_cam[:3, 3] += np.array([errors.forward_cm, errors.left_cm, errors.up_cm]) / 100
    return msgspec.structs.replace(
        told,
        fx=told.fx * stretch,
        fy=told.fy * stretch,
        T_body_cam=tuple(T_body_cam.ravel().tolist()),
        time_shift_s=told.time_shift_s + errors.time_shift_ms * 1e-3,
    )
