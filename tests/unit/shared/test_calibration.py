"""What a calibration says of the robot, also one that was written before it could be asked."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from shared.calibration import (
    REFERENCE_CAMERA,
    REFERENCE_HEAD,
    REFERENCE_IMU,
    REFERENCE_ROBOT,
    Calibration,
    DepthCalibration,
    Rig,
)
from shared.errors import ConfigError, DataError
from shared.geometry import se3, so3_exp
from shared.sensor_yaml import read_imu_noise, read_rig


@pytest.mark.parametrize(("kind", "has_wheels"), [("sentinel", True), ("generic", False), ("handheld rig", False)])
def test_the_kind_of_robot_in_recordings_and_hellos_says_whether_it_has_wheels(kind: str, has_wheels: bool) -> None:
    written = b'{"camera": null, "imu": null, "robot_kind": "%s"}' % kind.encode()
    assert msgspec.json.decode(written, type=Calibration).has_wheels is has_wheels


def test_a_calibration_of_no_known_robot_has_no_wheels() -> None:
    assert not msgspec.json.decode(b'{"camera": null, "imu": null}', type=Calibration).has_wheels


@pytest.mark.parametrize(("rig", "has_wheels"), [("wheels", True), ("hand-held", False), ("unknown", True)])
def test_what_carries_the_sensors_is_told_and_else_guessed_by_the_kind_of_robot(rig: Rig, has_wheels: bool) -> None:
    told = msgspec.structs.replace(REFERENCE_ROBOT, rig=rig)
    assert told.has_wheels is has_wheels
    assert msgspec.json.decode(msgspec.json.encode(told), type=Calibration) == told


def mounted(turned_deg: float, pitched_deg: float = 0.0, rig: Rig = "wheels") -> Calibration:
    """A robot whose camera is turned about its axis, clockwise as it looks, and looks up by `pitched_deg`."""
    R_forward = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    R_pitched = so3_exp(np.radians([0.0, -pitched_deg, 0.0]))
    R_turned = so3_exp(np.radians([0.0, 0.0, turned_deg]))
    T_body_cam = se3(R_pitched @ R_forward @ R_turned, np.array([0.1, 0.0, 0.2]))
    camera = msgspec.structs.replace(REFERENCE_CAMERA, T_body_cam=tuple(T_body_cam.ravel()))
    return Calibration(camera=camera, imu=None, rig=rig)


@pytest.mark.parametrize(("turned_deg", "up_deg"), [(0, 0), (2, 0), (-3, 0), (90, 270), (-92, 90), (181, 180)])
def test_a_robot_on_wheels_tells_which_way_is_up_in_its_images(turned_deg: float, up_deg: float) -> None:
    assert mounted(turned_deg).up_in_image_deg == up_deg
    assert mounted(turned_deg, pitched_deg=25.0).up_in_image_deg == up_deg
    assert REFERENCE_ROBOT.up_in_image_deg == 0.0


def test_nobody_knows_which_way_is_up_by_hand_or_in_a_view_of_the_ceiling() -> None:
    assert mounted(0.0, rig="hand-held").up_in_image_deg is None
    assert mounted(0.0, pitched_deg=80.0).up_in_image_deg is None
    assert Calibration(camera=None, imu=None, rig="wheels").up_in_image_deg is None


def test_a_rig_nobody_heard_of_is_refused_by_its_name(tmp_path: Path) -> None:
    assert read_rig({}, tmp_path) == "unknown" and read_rig({"rig": "hand-held"}, tmp_path) == "hand-held"
    with pytest.raises(DataError, match="rig is 'boat'; write one of wheels, hand-held, unknown"):
        read_rig({"rig": "boat"}, tmp_path)


EYE = tuple(np.eye(4).ravel().tolist())
ZONES = DepthCalibration(width=8, height=8, fx=9.66, fy=9.66, cx=3.5, cy=3.5)


@pytest.mark.parametrize(
    ("sensor", "changes", "words"),
    [
        (REFERENCE_CAMERA, {"fx": 1e-6, "fy": 1e-6}, "none that a lens gives"),
        (REFERENCE_CAMERA, {"fx": 50_000.0, "fy": 50_000.0}, "none that a lens gives"),
        (REFERENCE_CAMERA, {"fx": 10_000.0, "fy": 100.0}, "differ more than any sensor's pixels"),
        (REFERENCE_CAMERA, {"distortion": (1e6, 0.0, 0.0, 0.0)}, "no lens's"),
        (REFERENCE_CAMERA, {"T_body_cam": (*EYE[:3], 1e6, *EYE[4:])}, "further than 10 m"),
        (REFERENCE_CAMERA, {"T_body_cam": (*EYE[:12], 9.0, 9.0, 9.0, 9.0)}, "no rigid motion"),
        (REFERENCE_CAMERA, {"T_body_cam": tuple(2.0 * value for value in EYE)}, "no rigid motion"),
        (REFERENCE_CAMERA, {"T_body_cam": (-1.0, *EYE[1:])}, "no rigid motion"),
        (REFERENCE_CAMERA, {"T_body_cam": (1e300, *EYE[1:])}, "no rigid motion"),
        (REFERENCE_CAMERA, {"T_body_cam": (*EYE[:3], 1e300, *EYE[4:])}, "further than 10 m"),
        (REFERENCE_HEAD, {"pivot_body": (0.0, 100.0, 0.0)}, "further than 10 m"),
        (ZONES, {"width": 4096}, "outside 1..2048"),
        (ZONES, {"fx": 0.01}, "none that a depth sensor"),
        (ZONES, {"fy": 1e6}, "none that a depth sensor"),
        (ZONES, {"T_body_depth": (2.0, *EYE[1:])}, "T_body_depth is no rigid motion"),
        (ZONES, {"T_body_depth": EYE[:12]}, "has 12 numbers"),
        (ZONES, {"T_body_depth": (*EYE[:3], 11.0, *EYE[4:])}, "puts the depth sensor further"),
        (REFERENCE_IMU, {"gyro_density": 1e9}, "gyro_density is 1e"),
        (REFERENCE_IMU, {"accel_walk": -1.0}, "accel_walk is -1"),
        (REFERENCE_IMU, {"gyro_walk": 0.0}, "gyro_walk is 0, must be over 0"),
        (REFERENCE_IMU, {"rate_hz": -5.0}, "rate_hz is -5"),
        (REFERENCE_IMU, {"gyro_range": 0.0}, "must be over 0"),
        (REFERENCE_ROBOT, {"gravity": 0.0}, "gravity is 0"),
        (REFERENCE_ROBOT, {"gravity": -9.81}, "gravity is -9.81"),
    ],
)
def test_numbers_of_no_sensor_are_refused_by_whoever_reads_them(
    sensor: msgspec.Struct, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        msgspec.structs.replace(sensor, **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 4000, "height": 3000, "fx": 2900.0, "fy": 2900.0, "distortion": (0.2, -1.5, 0.001, 2.6)},  # a phone
        {"fx": 170.0, "fy": 171.0, "model": "equidistant"},  # a fisheye of 220 degrees
        {"fx": 30_000.0, "fy": 30_000.0},  # a telescope
        {"fx": 1000.0, "fy": 500.0},  # every second line left out
    ],
)
def test_unusual_cameras_are_cameras(changes: dict[str, object]) -> None:
    msgspec.structs.replace(REFERENCE_CAMERA, **changes)


def test_noise_of_no_imu_is_refused_with_the_files_name(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"imu\.yaml: the IMU's gyro_density"):
        read_imu_noise(tmp_path / "imu.yaml", {"gyroscope_noise_density": 1e9})


def test_a_depth_sensor_travels_with_the_calibration_and_is_left_out_where_there_is_none() -> None:
    assert b"depth" not in msgspec.json.encode(REFERENCE_ROBOT)
    told = msgspec.structs.replace(REFERENCE_ROBOT, depth=ZONES)
    assert msgspec.json.decode(msgspec.json.encode(told), type=Calibration) == told
    assert told.depth_sensor == ZONES and REFERENCE_ROBOT.depth_sensor is None
