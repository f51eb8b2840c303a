"""The check at the end of a guided recording without a target: as the command makes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from station.calibration.guided_steps import GuidedSteps
from station.calibration.targetless.check import check_calibration
from station.calibration.targetless.recording import lively
from station.datasets import open_dataset

SIGMAS = ("rotation_deg", "translation_m", "time_shift_s", "line_delay_s", "gravity")


def estimate_check(recording: Path, progress: Callable[[float, str], None]) -> dict[str, Any]:
    """What the robot's calibration should say, in the fields of a calibration of camera and IMU, and what that repairs.

    The notes say of each quantity whether it fits; what fits, or cannot be seen in this motion, stays as told.
    Raises DataError: the recording has no images.
    """
    data = open_dataset(recording, needs_camera=True)
    found = check_calibration(lively(data, data.calibration, recording), GuidedSteps(progress))
    results, told = found.results(), found.told
    names = (
        "T_body_cam", "time_shift_s", "line_delay_s", "gravity", "rms_px", "rms_gyro", "rms_accel", "intrinsics",
        "distortion", "accepted", "reasons", "notes", "fits", "repairs",
    )  # fmt: skip
    sigma = results["sigma"]
    return {name: results[name] for name in names} | {
        "sigma": None if sigma is None else {name: sigma[name] for name in SIGMAS},
        "model": told.model,
        "resolution": [told.width, told.height],
    }
