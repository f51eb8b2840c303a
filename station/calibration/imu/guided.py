"""The estimate at the end of a guided recording of an inertial unit at rest: as the command makes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from shared.errors import DataError
from station.calibration.imu.calibrate import calibrate_imu
from station.calibration.imu.plot import draw_allan
from station.calibration.imu.report import calibration_json
from station.datasets import open_dataset


def estimate_imu(recording: Path, plot: Path, progress: Callable[[float, str], None]) -> dict[str, Any]:
    """The noise in the fields of the contract, and the Allan plot. Raises DataError: nothing of it was recorded."""
    progress(0.05, "reading the recording")
    data = open_dataset(recording, needs_camera=False, needs_upright=False)
    if data.imu is None:
        raise DataError("nothing was recorded of the IMU; see to its cable, and begin again")
    progress(0.3, "fitting the noise")
    found = calibrate_imu(data.imu, data.calibration.imu, None, data.calibration.gravity)
    if found.gyro is not None and found.accel is not None:
        progress(0.9, "drawing the Allan deviation")
        draw_allan(found.gyro, found.accel, plot)
    return calibration_json(found)
