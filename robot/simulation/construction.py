"""How a robot is really built, where its calibration tells other numbers."""

from __future__ import annotations

import msgspec
import numpy as np

from robot.simulation.calibration.sensors import calibration_rng, draw_calibration
from robot.simulation.config import BuildErrors
from shared.calibration import CameraCalibration
from shared.geometry import se3, so3_exp


def built_camera(told: CameraCalibration, errors: BuildErrors) -> CameraCalibration:
    """The camera that takes the pictures and stamps them, for one whose calibration tells `told`."""
    if errors.seed is not None:
        told = _another_camera(told, errors.seed)
    stretch = 1.0 + errors.focal_percent / 100
    pitch, yaw, roll = (so3_exp(v) for v in np.diag(np.radians([errors.pitch_deg, errors.yaw_deg, errors.roll_deg])))
    turn = pitch @ yaw @ roll
    T_body_cam = told.T_body_cam_matrix @ se3(turn, np.zeros(3))
    T_body_cam[:3, 3] += np.array([errors.forward_cm, errors.left_cm, errors.up_cm]) / 100
    return msgspec.structs.replace(
        told,
        fx=told.fx * stretch,
        fy=told.fy * stretch,
        T_body_cam=tuple(T_body_cam.ravel().tolist()),
        time_shift_s=told.time_shift_s + errors.time_shift_ms * 1e-3,
        line_delay_s=told.line_delay_s + errors.line_delay_us * 1e-6,
    )


def _another_camera(told: CameraCalibration, seed: int) -> CameraCalibration:
    """Any camera of the told size and rate; with a global shutter where the told one has one."""
    drawn = draw_calibration(calibration_rng(seed)).camera
    assert drawn is not None
    line_delay_s = drawn.line_delay_s if told.line_delay_s else 0.0
    across, down = told.width / drawn.width, told.height / drawn.height
    return msgspec.structs.replace(
        drawn,
        width=told.width,
        height=told.height,
        fx=drawn.fx * across,
        fy=drawn.fy * down,
        cx=(drawn.cx + 0.5) * across - 0.5,
        cy=(drawn.cy + 0.5) * down - 0.5,
        rate_hz=told.rate_hz,
        line_delay_s=line_delay_s,
    )
