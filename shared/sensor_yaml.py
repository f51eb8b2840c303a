"""Calibration files: EuRoC's `sensor.yaml`, our `camera.yaml` (the same keys), and 3x3 intrinsics as text."""

from __future__ import annotations

import difflib
import io
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import yaml
from yaml.error import MarkedYAMLError

from shared.bounded import read_text, shown
from shared.calibration import (
    RIGS,
    AccelerometerCalibration,
    CameraCalibration,
    DepthCalibration,
    ImuNoise,
    Rig,
)
from shared.errors import ConfigError, DataError
from shared.geometry import FloatArray, orthonormal, se3

DISTORTION_MODELS = {
    "radial-tangential": "radtan",
    "radtan": "radtan",
    "plumb_bob": "radtan",
    "none": "radtan",
    "equidistant": "equidistant",
    "kannala_brandt4": "equidistant",
}
COEFFICIENTS = ("distortion_coefficients", "distortion_coeffs")  # EuRoC's key and kalibr's
# A dataset that does not say one of these gets the figure of a consumer-grade IMU, so that estimators stay cautious.
CONSUMER_IMU = {"gyro_density": 3e-4, "accel_density": 3e-3, "gyro_walk": 3e-5, "accel_walk": 3e-3}
NOISE_KEYS = {
    "gyro_density": "gyroscope_noise_density",
    "accel_density": "accelerometer_noise_density",
    "gyro_walk": "gyroscope_random_walk",
    "accel_walk": "accelerometer_random_walk",
}
# Ours, beside kalibr's: force = T (scale * reading), shared/calibration.py.
ACCELEROMETER_KEYS = {"scale": "accelerometer_scale", "misalignment": "accelerometer_misalignment"}
# What our commands' JSON objects call some keys of the files.
JSON_NAMES = {
    "distortion": "distortion_coefficients",
    "gyro_noise_density": "gyroscope_noise_density",
    "accel_noise_density": "accelerometer_noise_density",
    "gyro_random_walk": "gyroscope_random_walk",
    "accel_random_walk": "accelerometer_random_walk",
}

MOUNTINGS = ("T_BS", "T_body_cam")
# What we read of a camera's file, and of an IMU's, and what others write there.
CAMERA_KEYS = {
    *("resolution", "intrinsics", "distortion_model", *COEFFICIENTS, *MOUNTINGS, "time_shift_s", "line_delay_s"),
    *("rate_hz", "approximate", "exposure_s", "rig", "sensor_type", "comment", "camera_model", "rostopic"),
    *("T_cam_imu", "T_cn_cnm1", "timeshift_cam_imu", "line_delay", "cam_overlaps"),
}
IMU_KEYS = {
    *(*NOISE_KEYS.values(), *ACCELEROMETER_KEYS.values(), "rate_hz", "update_rate", "gyroscope_range"),
    *("accelerometer_range", "rostopic", "sensor_type", "comment", "T_BS", "T_i_b", "model", "time_offset"),
}
BESIDE = ("T_cn_cnm1", "T_i_b")  # kalibr's, between cameras and between IMUs
ALIKE = 0.8  # share of letters that two keys have in common, in order: one is a misprint of the other

MAX_EXPOSURE_S = 10.0
CAMERA_FILES = ("camera.yaml", "camera-intrinsics.txt")  # of a folder of images
DEPTH_FILE = "depth-intrinsics.txt"  # likewise


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file's mapping. OpenCV's first line `%YAML:1.0`, which YAML itself forbids, is passed over."""
    try:
        text = read_text(path)
    except FileNotFoundError as exc:
        raise DataError(f"there is no file {path}") from exc
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror or exc}); give a file of `key: value` lines") from exc
    except UnicodeDecodeError as exc:
        raise DataError(f"{path} is no text; give a file of `key: value` lines") from exc
    lines = [line for line in text.splitlines() if not line.startswith("%YAML")]
    try:
        # OpenCV marks its matrices with tags of its own, which the safe loader refuses. Ours is as safe as its base.
        content = yaml.load("\n".join(lines).replace("!!opencv-matrix", ""), _Loader)  # noqa: S506  # nosec B506
    except yaml.YAMLError as exc:
        raise DataError(f"{path} is not readable YAML ({_first_line(exc)}); correct it") from exc
    except (ValueError, RecursionError) as exc:  # a date that no calendar has, nesting without end
        raise DataError(f"{path} is not readable YAML ({exc}); correct it") from exc
    if not isinstance(content, dict):
        raise DataError(f"{path} holds no `key: value` lines; it is empty, or another file was meant")
    return content


class _Loader(yaml.SafeLoader):
    """Nothing is written once and meant a billion times: aliases, which no calibration has, are refused."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise MarkedYAMLError(problem="it has an alias, which is not read")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """A key that stands there twice would count by its last value, and a person sees the first."""
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for number, key in enumerate(keys):
            if any((key.tag, key.value) == (other.tag, other.value) for other in keys[:number]):
                raise MarkedYAMLError(problem=f"{shown(key.value)} stands there twice", problem_mark=key.start_mark)
        return super().construct_mapping(node, deep)


def read_rig(content: dict[str, Any], path: Path) -> Rig:
    """What carries the sensors: `rig: wheels` or `rig: hand-held`; unknown where the file does not say."""
    rig = content.get("rig", "unknown")
    if not isinstance(rig, str) or rig not in RIGS:
        raise DataError(f"{path}: rig is {shown(rig)}; write one of {', '.join(RIGS)}")
    return cast(Rig, rig)


def _first_line(exc: yaml.YAMLError) -> str:
    mark = getattr(exc, "problem_mark", None)
    problem = getattr(exc, "problem", None) or "unreadable"
    return f"line {mark.line + 1}: {problem}" if mark is not None else str(problem)


def numbers(content: dict[str, Any], key: str, count: int, path: Path) -> list[float]:
    """`count` numbers under a key. Raises DataError naming file and key."""
    value = content.get(key)
    if isinstance(value, dict):  # EuRoC's matrices: {cols, rows, data}
        value = value.get("data")
    try:
        flat = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        flat = np.empty(0)
    if len(flat) != count or not np.isfinite(flat).all():
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise DataError(f"{path}: {key} must be {wanted}, is {shown(value)}")
    return [float(x) for x in flat]


def number(content: dict[str, Any], key: str, default: float, path: Path) -> float:
    """One number under a key, or the default where the key is absent."""
    return default if content.get(key) is None else numbers(content, key, 1, path)[0]


def read_exposure_ns(content: dict[str, Any], path: Path) -> int:
    """The key `exposure_s`, of a camera that does not say it of every frame; 0 where absent: not known."""
    exposure_s = number(content, "exposure_s", 0.0, path)
    if not 0 <= exposure_s <= MAX_EXPOSURE_S:
        raise DataError(f"{path}: exposure_s is {exposure_s:g}, must be 0 to {MAX_EXPOSURE_S:g}")
    return round(1e9 * exposure_s)


def read_mounting(content: dict[str, Any], path: Path) -> FloatArray:
    """T_body_sensor (4, 4): the key `T_BS` (or `T_body_cam`), identity where absent."""
    for key in MOUNTINGS:
        if content.get(key) is not None:
            T = np.array(numbers(content, key, 16, path)).reshape(4, 4)
            if abs(np.linalg.det(T[:3, :3]) - 1.0) > 0.02:
                raise DataError(f"{path}: {key} is not a rigid motion (its rotation's determinant is not 1)")
            R = T[:3, :3]
            # One that was written in full is read as it was: calibrations are compared by their numbers.
            is_exact = np.abs(R @ R.T - np.eye(3)).max() < 1e-14
            return se3(R if is_exact else orthonormal(R), T[:3, 3])
    for key in content:
        if str(key).startswith("T_") and key not in (*MOUNTINGS, *BESIDE):
            raise DataError(f"{path}: {shown(key)} is not read; write how the sensor is mounted as {MOUNTINGS[1]}")
    return np.eye(4)


def read_camera(path: Path, content: dict[str, Any] | None = None) -> CameraCalibration:
    """Camera calibration from a `sensor.yaml` or `camera.yaml`; T_body_cam is the file's T_BS."""
    content = read_yaml(path) if content is None else content
    width, height = numbers(content, "resolution", 2, path)
    fx, fy, cx, cy = numbers(content, "intrinsics", 4, path)
    model = str(content.get("distortion_model", "none")).lower()
    if model not in DISTORTION_MODELS:
        raise DataError(f"{path}: distortion_model {shown(model)} is unknown; use radial-tangential or equidistant")
    distortion = _read_distortion(content, model, path)
    refuse_misprints(content, CAMERA_KEYS, path)
    try:
        return CameraCalibration(
            width=int(width),
            height=int(height),
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            model="equidistant" if DISTORTION_MODELS[model] == "equidistant" else "radtan",
            distortion=distortion,
            T_body_cam=tuple(read_mounting(content, path).ravel().tolist()),
            time_shift_s=number(content, "time_shift_s", 0.0, path),
            line_delay_s=number(content, "line_delay_s", 0.0, path),
            rate_hz=number(content, "rate_hz", 30.0, path),
            is_measured=not content.get("approximate", False),
        )
    except ConfigError as exc:
        raise DataError(f"{path}: {exc}") from exc


def _read_distortion(content: dict[str, Any], model: str, path: Path) -> tuple[float, ...]:
    """Four coefficients; zeros only where the file names no lens model either."""
    key = next((key for key in COEFFICIENTS if content.get(key) not in (None, [])), None)
    if key is None:
        _refuse_json_names(content, ("distortion",), path)
        if model != "none":
            raise DataError(
                f"{path}: distortion_model is {model} without distortion_coefficients; write these, or the model none"
            )
        return (0.0,) * 4
    given = content[key]
    given = given.get("data") if isinstance(given, dict) else given
    count = len(given) if isinstance(given, list) and 1 <= len(given) <= 5 else 4
    values = numbers(content, key, count, path)
    if any(v != 0.0 for v in values[4:]):
        raise DataError(f"{path}: {key} may be k1, k2, p1, p2; a non-zero k3 is not supported")
    return tuple([*values, 0.0, 0.0, 0.0][:4])


def refuse_misprints(content: dict[str, Any], keys: Iterable[str], path: Path) -> None:
    """Raises DataError where a key is hardly another than one of these, which is missing. Others are passed over."""
    missing = sorted(set(keys) - content.keys())
    for key in content.keys() - set(keys):
        if meant := difflib.get_close_matches(str(key)[:80], missing, n=1, cutoff=ALIKE):
            raise DataError(f"{path}: there is no key {shown(key)}; write {meant[0]}")


def _refuse_json_names(content: dict[str, Any], names: Iterable[str], path: Path) -> None:
    for name in names:
        if name in content:
            raise DataError(f"{path}: {name} is what --json calls it; in a file it is {JSON_NAMES[name]}")


def read_bare_camera(path: Path) -> CameraCalibration:
    """A camera that is itself the body, as without an IMU: a mounting in the file is passed over."""
    return read_camera(path, {k: v for k, v in read_yaml(path).items() if not str(k).startswith("T_")})


def read_folder_camera(folder: Path, image_size: Callable[[], tuple[int, int]]) -> CameraCalibration:
    """The camera of a folder of images: its `camera.yaml`, or `camera-intrinsics.txt` and the size of an image."""
    yaml_path, text_path = (folder / name for name in CAMERA_FILES)
    if yaml_path.exists():
        return read_bare_camera(yaml_path)
    if not text_path.exists():
        raise DataError(f"{folder} has no camera.yaml (or camera-intrinsics.txt); write the camera's intrinsics there")
    (fx, _, cx), (_, fy, cy), _ = read_intrinsics_text(text_path).tolist()
    width, height = image_size()  # and 30 images a second, as 7-Scenes has them
    return CameraCalibration(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, rate_hz=30.0)


def read_folder_depth(folder: Path, image_size: Callable[[], tuple[int, int]]) -> DepthCalibration | None:
    """The depth sensor of a folder of images: its `depth-intrinsics.txt`, and the size of a depth picture.

    Nobody says where it sits beside the camera: as if in its place. None where the file is not there.
    """
    path = folder / DEPTH_FILE
    if not path.exists():
        return None
    (fx, _, cx), (_, fy, cy), _ = read_intrinsics_text(path).tolist()
    width, height = image_size()
    try:
        return DepthCalibration(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, is_measured=False)
    except ConfigError as exc:
        raise DataError(f"{path}: {exc}") from exc


def read_imu_noise(path: Path, content: dict[str, Any]) -> ImuNoise:
    """Noise figures from an IMU's `sensor.yaml`, or from kalibr's `imu.yaml` (its results have a section `imu0`).

    A figure that is not there, or 0 as of a perfect sensor, is a consumer-grade IMU's.
    """
    content = _imu_section(content)
    _refuse_json_names(content, (name for name in JSON_NAMES if JSON_NAMES[name] in NOISE_KEYS.values()), path)
    refuse_misprints(content, IMU_KEYS, path)

    def reach(key: str) -> float:  # a range without limit, as the simulator writes for a given recording
        return np.inf if content.get(key) == np.inf else number(content, key, np.inf, path)

    try:
        return ImuNoise(
            **{name: number(content, key, 0.0, path) or CONSUMER_IMU[name] for name, key in NOISE_KEYS.items()},
            rate_hz=number(content, "rate_hz", number(content, "update_rate", 200.0, path), path),
            gyro_range=reach("gyroscope_range"),
            accel_range=reach("accelerometer_range"),
            accelerometer=_read_accelerometer(path, content),
        )
    except ConfigError as exc:
        raise DataError(f"{path}: {exc}") from exc


def consumer_imu(rate_hz: float) -> ImuNoise:
    """What is believed of an IMU of which nobody told anything."""
    return ImuNoise(
        gyro_density=CONSUMER_IMU["gyro_density"],
        accel_density=CONSUMER_IMU["accel_density"],
        gyro_walk=CONSUMER_IMU["gyro_walk"],
        accel_walk=CONSUMER_IMU["accel_walk"],
        rate_hz=rate_hz,
    )


def _read_accelerometer(path: Path, content: dict[str, Any]) -> AccelerometerCalibration | msgspec.UnsetType:
    given = {name: numbers(content, key, 3, path) for name, key in ACCELEROMETER_KEYS.items() if key in content}
    if "scale" not in given:
        return msgspec.UNSET
    return AccelerometerCalibration(**{name: (x, y, z) for name, (x, y, z) in given.items()})


def read_own_noise(path: Path, content: dict[str, Any]) -> ImuNoise:
    """Noise figures from a file that is there to say them: one that says none is refused."""
    section = _imu_section(content)
    for key in NOISE_KEYS.values():
        if section.get(key) == 0:
            raise DataError(f"{path}: {key} is 0, must be over 0; no sensor is without noise")
    noise = read_imu_noise(path, content)
    if not section.keys() & set(NOISE_KEYS.values()):
        raise DataError(f"{path} says none of {', '.join(NOISE_KEYS.values())}; `station calibrate imu` measures them")
    return noise


def _imu_section(content: dict[str, Any]) -> dict[str, Any]:
    section = content.get("imu0")
    return section if isinstance(section, dict) else content


def read_intrinsics_text(path: Path) -> FloatArray:
    """A camera matrix (3, 3) from a text file."""
    try:
        K = np.loadtxt(io.StringIO(read_text(path)), dtype=np.float64, ndmin=2)
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); copy it again") from exc
    except (ValueError, UserWarning) as exc:
        raise DataError(f"{path} is not a 3x3 matrix of numbers; correct it") from exc
    if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise DataError(f"{path} is not a 3x3 camera matrix (fx 0 cx, 0 fy cy, 0 0 1); correct it")
    return np.asarray(K)
