"""The kinds of calibration recordings."""

from __future__ import annotations

from enum import StrEnum


class Kind(StrEnum):
    """What is to be calibrated."""

    CAMERA = "camera"  # stills of a board moved before the camera
    CAMERA_IMU = "camera-imu"  # camera and IMU waved before a board on the wall
    IMU = "imu"  # an IMU at rest, no images
    WHEELS = "wheels"  # a robot drives before a board and turns
