"""`calibration.yaml`: all that is known of one robot's sensors and wheels, written and read by robot and station.

Its sections `camera` and `imu` have the keys of our `camera.yaml` and of EuRoC's `sensor.yaml`.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import msgspec
import yaml

from shared.calibration import AccelerometerCalibration, Calibration, CameraCalibration, ImuNoise, WheelCalibration
from shared.errors import ConfigError, DataError
from shared.sensor_yaml import (
    ACCELEROMETER_KEYS,
    number,
    read_camera,
    read_own_noise,
    read_rig,
    read_yaml,
    refuse_misprints,
)

IMU_HEAD = "# Noise of an inertial unit in continuous time, SI units (docs/calibration.md).\n"
HEAD = "# What is known of this robot's sensors (docs/robot.md). t_imu = t_cam + time_shift_s.\n"
WHEELS = ("speed", "turn")  # keys of the section `wheels`
KEYS = ("robot_kind", "rig", "gravity", "camera", "imu", "wheels", "previous")
IDENTITY = [float(row == column) for row in range(4) for column in range(4)]
PREVIOUS = KEYS[-1]  # the section of the calibration before: one file, so that both change at once or not at all


def calibration_text(calibration: Calibration, previous: Calibration | None = None) -> str:
    """The file's content; every number is read back as it is, and `previous` by `read_previous`."""
    content = _content(calibration)
    if previous is not None:
        content[PREVIOUS] = _content(previous)
    return HEAD + _yaml(content)


def calibration_digest(calibration: Calibration) -> str:
    """The same for two that a robot's file says in the same words."""
    return hashlib.sha256(calibration_text(calibration).encode()).hexdigest()


def _content(calibration: Calibration) -> dict[str, Any]:
    content: dict[str, Any] = {
        "robot_kind": calibration.robot_kind,
        "rig": calibration.rig,
        "gravity": float(calibration.gravity),
    }
    if calibration.camera is not None:
        content["camera"] = camera_content(calibration.camera)
    if calibration.imu is not None:
        content["imu"] = _imu_content(calibration.imu)
    if isinstance(calibration.wheels, WheelCalibration):
        content["wheels"] = {key: float(getattr(calibration.wheels, key)) for key in WHEELS}
    return content


def camera_content(camera: CameraCalibration) -> dict[str, Any]:
    """As `read_camera` reads it."""
    approximate = {} if camera.is_measured else {"approximate": True}
    return {
        "resolution": [camera.width, camera.height],
        "rate_hz": float(camera.rate_hz),
        "intrinsics": [float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy)],
        "distortion_model": "equidistant" if camera.model == "equidistant" else "radial-tangential",
        "distortion_coefficients": [float(v) for v in camera.distortion],
        "T_body_cam": [float(v) for v in camera.T_body_cam],
        "time_shift_s": float(camera.time_shift_s),
        "line_delay_s": float(camera.line_delay_s),
        **approximate,
    }


def _imu_content(imu: ImuNoise) -> dict[str, Any]:
    known = imu.accelerometer
    measured = isinstance(known, AccelerometerCalibration)
    return {
        "rate_hz": float(imu.rate_hz),
        "gyroscope_noise_density": float(imu.gyro_density),
        "gyroscope_random_walk": float(imu.gyro_walk),
        "accelerometer_noise_density": float(imu.accel_density),
        "accelerometer_random_walk": float(imu.accel_walk),
        "gyroscope_range": float(imu.gyro_range),
        "accelerometer_range": float(imu.accel_range),
        **(
            {key: [float(v) for v in getattr(known, name)] for name, key in ACCELEROMETER_KEYS.items()}
            if measured
            else {}
        ),
    }


def imu_text(imu: ImuNoise) -> str:
    """An `imu.yaml` as kalibr reads it, and `read_imu_noise`, so that it serves as a dataset's `imu0/sensor.yaml`."""
    finite = {key: value for key, value in _imu_content(imu).items() if value != math.inf}
    content = {"rostopic": "/imu0", "update_rate": float(imu.rate_hz), **finite}
    return IMU_HEAD + yaml.safe_dump(content, sort_keys=False)


def camera_sensor_text(camera: CameraCalibration, **more: str) -> str:
    """`cam0/sensor.yaml` of an ASL folder: EuRoC's keys, those of ours that EuRoC lacks, and `more`."""
    content = camera_content(camera)
    mounting = _asl_mounting(content.pop("T_body_cam"))
    return _yaml({"sensor_type": "camera", "camera_model": "pinhole", "T_BS": mounting, **content, **more})


def imu_sensor_text(imu: ImuNoise) -> str:
    """`imu0/sensor.yaml` of an ASL folder, likewise; the IMU is the body."""
    return _yaml({"sensor_type": "imu", "T_BS": _asl_mounting(IDENTITY), **_imu_content(imu)})


def _asl_mounting(T_body_sensor: list[float]) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T_body_sensor}


def _yaml(content: dict[str, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=200)


def read_imu(path: Path) -> ImuNoise:
    """An `imu.yaml` of ours or kalibr's. Raises DataError, which names the file and the key."""
    return read_own_noise(path, read_yaml(path))


def read_calibration(path: Path) -> Calibration:
    """A robot's `calibration.yaml`. Raises DataError, which names the file and the key."""
    return as_calibration(read_yaml(path), path)


def read_previous(path: Path) -> Calibration | None:
    """The calibration before the one in a robot's `calibration.yaml`; None: it keeps none. Raises DataError."""
    section = _section(read_yaml(path), PREVIOUS, path)
    return None if section is None else as_calibration(section, path)


def as_calibration(content: dict[str, Any], path: Path) -> Calibration:
    """A file's mapping as a calibration; `path` is what its errors call it. Raises DataError."""
    refuse_misprints(content, KEYS, path)
    sections = {name: _section(content, name, path) for name in ("camera", "imu", "wheels")}
    if sections["camera"] is None and sections["imu"] is None:
        raise DataError(f"{path} has neither a camera nor an imu section; it is no calibration.yaml")
    camera, imu, wheels = sections["camera"], sections["imu"], sections["wheels"]
    try:
        return Calibration(
            camera=None if camera is None else read_camera(path, camera),
            imu=None if imu is None else read_own_noise(path, imu),
            robot_kind=str(content.get("robot_kind", "generic")),
            gravity=number(content, "gravity", 9.81, path),
            rig=read_rig(content, path),
            wheels=msgspec.UNSET
            if wheels is None
            else WheelCalibration(**{k: number(wheels, k, 1.0, path) for k in WHEELS}),
        )
    except ConfigError as exc:
        raise DataError(f"{path}: {exc}") from exc


def _section(content: dict[str, Any], name: str, path: Path) -> dict[str, Any] | None:
    section = content.get(name)
    if section is not None and not isinstance(section, dict):
        raise DataError(f"{path}: {name} must be a section of `key: value` lines")
    return section
