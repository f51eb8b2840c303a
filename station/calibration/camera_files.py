"""Calibration files of a camera: our `camera.yaml`, written, and kalibr's camchain, written and read.

Source: kalibr's wiki, "YAML formats". kalibr's T_cam_imu maps the IMU's coordinates to the camera's, and its
timeshift_cam_imu is ours: t_imu = t_cam + shift.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from shared.bounded import shown
from shared.calibration import CameraCalibration
from shared.calibration_yaml import as_calibration
from shared.errors import DataError
from shared.geometry import FloatArray, inverse, orthonormal, se3
from shared.sensor_yaml import CAMERA_KEYS, numbers, read_camera, read_yaml, refuse_misprints

OUR_NAMES = {"radtan": "radial-tangential", "equidistant": "equidistant"}
KALIBR_NAMES = {"radtan": "radtan", "equidistant": "equidistant"}


def lens_yaml(size: tuple[int, int], intrinsics: list[float], model: str, distortion: list[float]) -> str:
    """What robot-server and every dataset of images read of a camera whose mounting is not known."""
    return (
        f"resolution: [{size[0]}, {size[1]}]\n"
        "camera_model: pinhole\n"
        f"intrinsics: {_list(intrinsics)}    # fx fy cx cy, px\n"
        f"distortion_model: {OUR_NAMES[model]}\n"
        f"distortion_coefficients: {_list(distortion)}\n"
    )


def opencv_yaml(size: tuple[int, int], intrinsics: list[float], distortion: list[float]) -> str:
    """A lens as OpenCV's calibration sample writes it: with k1 k2 p1 p2 and up to four more."""
    fx, fy, cx, cy = intrinsics
    storage = cv2.FileStorage(".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", size[0])
    storage.write("image_height", size[1])
    storage.write("camera_matrix", np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
    storage.write("distortion_coefficients", np.array([distortion]))
    return storage.releaseAndGetString()


def camchain_yaml(camera: CameraCalibration) -> str:
    """kalibr's camchain of one camera."""
    return lens_camchain_yaml(
        (camera.width, camera.height),
        [camera.fx, camera.fy, camera.cx, camera.cy],
        camera.model,
        list(camera.distortion),
    ) + (
        "  T_cam_imu:\n"
        + "".join(f"  - {_list(row)}\n" for row in camera.T_cam_body_matrix.tolist())
        + f"  timeshift_cam_imu: {camera.time_shift_s!r}\n"
        + f"  line_delay: {camera.line_delay_s!r}\n"
    )


def lens_camchain_yaml(size: tuple[int, int], intrinsics: list[float], model: str, distortion: list[float]) -> str:
    """kalibr's camchain of one camera whose mounting is not known."""
    return (
        "cam0:\n"
        "  camera_model: pinhole\n"
        f"  intrinsics: {_list(intrinsics)}\n"
        f"  distortion_model: {KALIBR_NAMES[model]}\n"
        f"  distortion_coeffs: {_list(distortion)}\n"
        f"  resolution: [{size[0]}, {size[1]}]\n"
        "  rostopic: /cam0/image_raw\n"
    )


def read_camera_file(path: Path) -> CameraCalibration | None:
    """Of a calibration.yaml, a camchain of kalibr's or a camera.yaml; None where the first has no camera."""
    content = read_yaml(path)
    if "camera" in content:
        return as_calibration(content, path).camera
    return read_camchain(path) if "cam0" in content else read_camera(path, content)


def read_camchain(path: Path) -> CameraCalibration:
    """The first camera of a kalibr camchain. Raises DataError naming file, key and remedy."""
    content = read_yaml(path).get("cam0")
    if not isinstance(content, dict):
        raise DataError(f"{path} has no cam0; give a camchain of kalibr's")
    refuse_misprints(content, CAMERA_KEYS, path)
    if content.get("camera_model", "pinhole") != "pinhole":
        raise DataError(f"{path}: camera_model is {shown(content['camera_model'])}; only pinhole is used")
    T_body_cam = inverse(_rigid(content, "T_cam_imu", path))
    return read_camera(
        path,
        {
            "resolution": content.get("resolution"),
            "intrinsics": content.get("intrinsics"),
            "distortion_model": content.get("distortion_model", "none"),
            "distortion_coeffs": content.get("distortion_coeffs"),
            "T_BS": T_body_cam.ravel().tolist(),
            "time_shift_s": content.get("timeshift_cam_imu"),
            "line_delay_s": content.get("line_delay"),
        },
    )


def _rigid(content: dict[str, Any], key: str, path: Path) -> FloatArray:
    """A rigid motion (4, 4), identity where the key is absent."""
    if content.get(key) is None:
        return np.eye(4)
    T = np.array(numbers(content, key, 16, path)).reshape(4, 4)
    if abs(np.linalg.det(T[:3, :3]) - 1.0) > 0.02:
        raise DataError(f"{path}: {key} is not a rigid motion (its rotation's determinant is not 1)")
    return se3(orthonormal(T[:3, :3]), T[:3, 3])


def _list(values: list[float]) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"
