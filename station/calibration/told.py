"""What is known beforehand: a dataset's own calibration, or what files of ours or kalibr's say instead."""

from __future__ import annotations

from pathlib import Path

import msgspec

from shared.calibration import Calibration
from shared.calibration_yaml import as_calibration
from shared.errors import DataError
from shared.sensor_yaml import read_own_noise, read_yaml
from station.calibration.camera_files import read_camera_file

MOUNTINGS = ("T_BS", "T_body_cam", "T_cam_imu")


def told(own: Calibration, camera: Path | None, imu: Path | None) -> Calibration:
    """With the lens of a camera's file and the noise of an IMU's, where these are given."""
    if camera is not None:
        own = msgspec.structs.replace(own, camera=read_camera_file(camera))
    if imu is not None:
        content = read_yaml(imu)
        noise = as_calibration(content, imu).imu if "imu" in content else read_own_noise(imu, content)
        own = msgspec.structs.replace(own, imu=noise)
    return own


def told_whole(own: Calibration, path: Path) -> Calibration:
    """A robot's calibration.yaml; or the dataset's own with camera and mounting of a camchain or camera.yaml.

    Raises:
        DataError: the file does not say how the camera is mounted.
    """
    content = read_yaml(path)
    if "camera" in content or "imu" in content:
        return as_calibration(content, path)
    section = content.get("cam0", content)
    if not isinstance(section, dict) or all(section.get(key) is None for key in MOUNTINGS):
        raise DataError(
            f"{path} does not say how the camera is mounted (T_cam_imu of a camchain, T_BS of a camera.yaml)"
        )
    return msgspec.structs.replace(own, camera=read_camera_file(path))
