"""What a guided calibration came to, as the page is told and as the robot is ordered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from shared.calibration import (
    REFERENCE_IMU,
    REFERENCE_ROBOT,
    AccelerometerCalibration,
    Calibration,
    WheelCalibration,
    has_borrowed_mounting,
)
from shared.calibration_yaml import calibration_text, read_calibration
from shared.geometry import FloatArray
from station.api.schema.calibration import ordered_calibration
from station.api.schema.calibration_session import ImuResult, calibration_by_result, is_used, order_of_result
from station.calibration.guidance import GuidedKind
from station.calibration.imu.calibrate import calibrate_imu
from station.calibration.imu.report import calibration_json
from station.calibration.target_page import printed_target
from station.calibration.wheels import Factor, Wheels
from station.calibration.wheels_guided import wheels_result
from station.errors import Conflict
from station.model.frames import ImuBatch
from station.robots.guided_calibration import CalibrationSession
from tests.support.inertial_noise import EDGES, FACES, turned


def session(kind: GuidedKind, result: dict[str, Any], told: Calibration = REFERENCE_ROBOT) -> CalibrationSession:
    return CalibrationSession("cal-1", kind, None, Path("/"), told, "robot", state="done", result=result)


def at_rest(seconds: float) -> dict[str, Any]:
    rng, rate_hz = np.random.default_rng(4), 200.0
    t_ns = (np.arange(seconds * rate_hz) * 1e9 / rate_hz).astype(np.int64)
    gyro = rng.normal(0.0, REFERENCE_IMU.gyro_density * np.sqrt(rate_hz), (len(t_ns), 3))
    accel = rng.normal((0.0, 0.0, 9.81), REFERENCE_IMU.accel_density * np.sqrt(rate_hz), (len(t_ns), 3))
    return calibration_json(calibrate_imu(ImuBatch(t_ns, gyro, accel)))


def measured(speed: float, turn: float) -> dict[str, Any]:
    factors = (Factor(value, 0.01, 0.01, 4) for value in (speed, turn))
    return wheels_result(Wheels(*factors, 0.08, 0.01, (), ()))


def test_what_the_imu_measures_at_rest_is_ordered_and_nothing_else_is_changed() -> None:
    result = at_rest(70.0)
    assert ImuResult.model_validate(result).accepted, result["reasons"]
    after = ordered_calibration(REFERENCE_ROBOT, order_of_result(session("imu", result)))
    assert after.imu is not None and after.imu.gyro_density == pytest.approx(REFERENCE_IMU.gyro_density, rel=0.1)
    assert msgspec.structs.replace(after, imu=REFERENCE_ROBOT.imu) == REFERENCE_ROBOT


def test_half_a_minute_at_rest_is_refused_in_words() -> None:
    with pytest.raises(Conflict, match="needs 60 s at rest"):
        order_of_result(session("imu", at_rest(30.0)))


def test_wheels_count_on_top_of_what_the_robot_drove_with() -> None:
    told = msgspec.structs.replace(REFERENCE_ROBOT, wheels=WheelCalibration(speed=0.8, turn=0.5))
    order = order_of_result(session("wheels", measured(1.25, 0.9), told))
    after = ordered_calibration(told, order)
    assert after.wheels == WheelCalibration(speed=1.0, turn=0.45)
    assert ordered_calibration(after, order) == after  # used twice it counts once


def test_an_accelerometer_that_was_laid_on_its_sides_is_ordered_with_its_errors(tmp_path: Path) -> None:
    found = calibrate_imu(turned(2, np.vstack([FACES, EDGES])).imu)
    result = calibration_json(found)
    after = calibration_by_result(session("imu", result), REFERENCE_ROBOT)
    assert after.imu is not None and isinstance(after.imu.accelerometer, AccelerometerCalibration)
    assert list(after.imu.accelerometer.scale) == result["accelerometer"]["scale"]
    file = tmp_path / "calibration.yaml"
    file.write_text(calibration_text(after))
    assert read_calibration(file).imu == after.imu  # as the robot keeps it over a restart
    assert order_of_result(session("imu", at_rest(70.0))).imu is not None
    again = ordered_calibration(after, order_of_result(session("imu", at_rest(70.0))))
    assert again.imu is not None and again.imu.accelerometer == after.imu.accelerometer  # not measured, so kept


def checked(repairs: list[str], T_body_cam: FloatArray) -> dict[str, Any]:
    """A check without a board that the motion sufficed for."""
    camera = REFERENCE_ROBOT.camera
    assert camera is not None
    numbers = (
        "line_delay_s", "gravity", "sigma", "rms_px", "rms_gyro", "rms_accel", "intrinsics", "distortion",
    )  # fmt: skip
    return dict.fromkeys(numbers) | {
        "T_body_cam": T_body_cam.tolist(), "time_shift_s": camera.time_shift_s, "model": camera.model,
        "resolution": [camera.width, camera.height], "accepted": True, "reasons": [], "notes": [],
        "fits": not repairs, "repairs": repairs,
    }  # fmt: skip


def test_a_check_that_repairs_nothing_is_nothing_to_be_used() -> None:
    camera = REFERENCE_ROBOT.camera
    assert camera is not None
    nothing = session("check", checked([], camera.T_body_cam_matrix))
    with pytest.raises(Conflict, match="nothing to repair"):
        calibration_by_result(nothing, REFERENCE_ROBOT)
    assert not is_used(nothing, REFERENCE_ROBOT)


def test_a_result_is_refused_once_the_numbers_it_rests_on_were_replaced() -> None:
    camera = REFERENCE_ROBOT.camera
    assert camera is not None
    T = camera.T_body_cam_matrix
    T[0, 3] += 0.02
    repaired = session("check", checked(["position"], T))
    after = calibration_by_result(repaired, REFERENCE_ROBOT)
    assert after.camera is not None and after.camera.T_body_cam_matrix[0, 3] == T[0, 3]
    assert is_used(repaired, after) and calibration_by_result(repaired, after) == after  # a second press does no harm
    other_lens = msgspec.structs.replace(REFERENCE_ROBOT, camera=msgspec.structs.replace(camera, fx=camera.fx + 9.0))
    with pytest.raises(Conflict, match="other numbers since"):
        calibration_by_result(repaired, other_lens)
    new_wheels = msgspec.structs.replace(REFERENCE_ROBOT, wheels=WheelCalibration(speed=0.8, turn=0.5))
    assert calibration_by_result(repaired, new_wheels).camera == after.camera  # they have nothing to do with it


def test_a_lens_that_was_calibrated_alone_leaves_the_mounting_another_robots() -> None:
    camera = REFERENCE_ROBOT.camera
    assert camera is not None and not has_borrowed_mounting(camera)  # the reference robot's own
    lens = msgspec.structs.replace(camera, fx=900.0, fy=900.0)
    assert has_borrowed_mounting(lens)
    assert not has_borrowed_mounting(msgspec.structs.replace(lens, time_shift_s=camera.time_shift_s + 1e-6))


def test_a_printed_board_is_as_large_as_its_ruler_says() -> None:
    whole, shrunk = (printed_target("aprilgrid", "A4", ruler_mm) for ruler_mm in (100.0, 97.0))
    assert shrunk.corners == pytest.approx(0.97 * whole.corners)
