"""The estimate at the end of a guided calibration of camera and IMU: from the recording, as the command makes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from shared.calibration import CameraCalibration
from shared.errors import DataError
from station.calibration.camera_imu.calibrate import calibrate_camera_imu
from station.calibration.camera_imu.page import write_camera_imu_page
from station.calibration.camera_imu.recording import open_thinned, read_recording
from station.calibration.guided_steps import DRAWING, GuidedSteps
from station.calibration.target import Target


def estimate_camera_imu(
    recording: Path, target: Target, told: CameraCalibration, plot: Path, progress: Callable[[float, str], None]
) -> dict[str, Any]:
    """Mounting, time shift and line delay in the fields of the contract, with the lens as it was refined.

    Where that comes to an estimate, a plot of what is left over is written as PNG.
    Raises DataError: the recording has no images.
    """
    steps = GuidedSteps(progress)
    data = open_thinned(recording)
    if not data.has_images:
        raise DataError("nothing was recorded of the camera; see to its cable, and begin again")
    found = calibrate_camera_imu(read_recording(data, target, told, data.calibration, steps), steps.estimate)
    if found.solution is not None:
        progress(DRAWING, "drawing what is left over")
        write_camera_imu_page(found.solution, plot)
    return found.results() | {"model": told.model, "resolution": [told.width, told.height]}
