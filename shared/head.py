"""Where a pan-tilt head has the camera: the head's frame is the body's, turned about the pivot.

T_world_head = T_world_body @ T_body_head, and the camera is fixed to the head: T_world_cam = T_world_head @ T_body_cam
with the calibration's T_body_cam. Of a head that looks straight ahead, and of a camera that is fixed to the body,
T_body_head is the identity.
"""

from __future__ import annotations

import math

import numpy as np

from shared.calibration import HeadCalibration
from shared.geometry import FloatArray, se3


def turned(head: HeadCalibration, pan: float, tilt: float) -> FloatArray:
    """T_body_head (4, 4) of a head that looks `pan` to the left and `tilt` up (rad)."""
    cp, sp, ct, st = math.cos(pan), math.sin(pan), math.cos(tilt), math.sin(tilt)
    R = np.array([[cp * ct, -sp, -cp * st], [sp * ct, cp, -sp * st], [st, 0.0, ct]])  # Rz(pan) Ry(-tilt)
    pivot = np.array(head.pivot_body)
    return se3(R, pivot - R @ pivot)
