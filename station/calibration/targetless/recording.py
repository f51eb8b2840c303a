"""A dataset as what a check without a target reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shared.calibration import Calibration
from shared.errors import DataError
from shared.sensor_yaml import consumer_imu
from station.calibration import CALIBRATE_CAMERA
from station.calibration.targetless.check import LivelyRecording
from station.datasets import Dataset
from station.model.frames import ImuBatch


def lively(data: Dataset, known: Calibration, where: Path) -> LivelyRecording:
    """A dataset as what is checked. Raises DataError: it has no images, or its lens is not known."""
    if data.read_frames is None:
        raise DataError(f"{data.path} holds no images; record the camera as well")
    if known.camera is None or not known.camera.is_measured:
        raise DataError(f"{where}: the lens is not known; {CALIBRATE_CAMERA} first, and give --calibration")
    empty = ImuBatch(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    return LivelyRecording(
        frame_times_ns=data.frame_times_ns,
        read_frames=data.read_frames,
        imu=data.imu or empty,
        camera=known.camera,
        noise=known.imu or data.calibration.imu or consumer_imu(200.0),
        gravity=known.gravity,
        drive=tuple(data.drive),
    )
