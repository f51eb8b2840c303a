"""Whether the drive shows that its calibration is wrong, and how."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from shared.calibration import REFERENCE_CAMERA, Calibration, ImuNoise
from shared.geometry import so3_exp
from station.model.calibration_fit import CalibrationFit
from station.slam.mapping.calibration_information import CalibrationInformation, combined
from station.slam.ukf.map.calibration_check import MAX_WAITING, WINDOW, CalibrationCheck
from station.vision.camera_model import CameraModel
from tests.support.synthetic_run import true_keyframes

NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
CAMERA = msgspec.structs.replace(REFERENCE_CAMERA, fx=458.0, fy=457.0, line_delay_s=0.0, time_shift_s=0.0)
CALIBRATION = Calibration(camera=CAMERA, imu=NOISE)
DURATION_S, RATE_HZ = 21.0, 20.0 / 3.0  # as far apart as keyframes are looked at


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As the backend does it: threads that wait for each other cost these small matrices many times their work."""
    with threadpool_limits(1):
        yield


def told(focal: float = 1.0, turned_deg: tuple[float, float, float] = (0, 0, 0), shift_s: float = 0.0) -> Calibration:
    """The calibration as a robot may tell it: focal length times `focal`, the camera turned, images stamped late."""
    T = CAMERA.T_body_cam_matrix
    T[:3, :3] = T[:3, :3] @ so3_exp(np.radians(turned_deg))
    camera = msgspec.structs.replace(
        CAMERA, fx=focal * CAMERA.fx, fy=focal * CAMERA.fy, T_body_cam=tuple(T.ravel().tolist()), time_shift_s=shift_s
    )
    return msgspec.structs.replace(CALIBRATION, camera=camera)


def check_of(calibration: Calibration) -> CalibrationCheck:
    assert calibration.camera is not None and calibration.imu is not None
    return CalibrationCheck(CameraModel.of(calibration.camera, 1.0), calibration.imu, calibration.gravity)


def fit_of(calibration: Calibration, seed: int, sigma_px: float = 1.0, outliers: float = 0.0) -> CalibrationFit:
    check = check_of(calibration)
    for keyframe in true_keyframes(CALIBRATION, calibration, seed, DURATION_S, sigma_px, outliers, RATE_HZ):
        check.add(keyframe)
    fit = check.finish()
    assert fit is not None
    return fit


@pytest.mark.parametrize("sigma_px", [0.3, 1.0, 1.5])
def test_a_right_calibration_fits_whatever_the_noise_of_the_pixels(sigma_px: float) -> None:
    """The noise of the pixels must not pull the focal length: as its square it would, 0.4 % at 1 px."""
    fits = [fit_of(CALIBRATION, seed, sigma_px) for seed in range(4)]
    assert [fit.verdict for fit in fits] == ["fits"] * 4
    assert np.mean([fit.focal_scale for fit in fits]) == pytest.approx(1.0, abs=0.0015)
    assert np.mean([fit.mounting_deg for fit in fits], axis=0) == pytest.approx(np.zeros(3), abs=0.1)
    assert np.mean([fit.time_shift_s for fit in fits]) == pytest.approx(0.0, abs=0.0005)


@pytest.mark.parametrize("focal", [0.95, 0.97, 1.03, 1.05])
def test_a_wrong_focal_length_is_found_and_said(focal: float) -> None:
    fit = fit_of(told(focal=focal), seed=1)
    assert fit.focal_scale == pytest.approx(
        1.0 / focal, abs=0.2 * abs(1.0 / focal - 1.0)
    )  # linearised where it was told
    assert fit.verdict == "does not fit"
    assert ("too long" if focal > 1.0 else "too short") in fit.sentence and "calibrate the camera" in fit.sentence


@pytest.mark.parametrize("focal", [0.985, 1.015])
def test_a_focal_length_that_is_borne_is_no_misfit(focal: float) -> None:
    assert fit_of(told(focal=focal), seed=2).verdict == "fits"


@pytest.mark.parametrize("axis", range(3))
def test_a_turned_camera_is_found_about_the_axis_that_it_is_turned_about(axis: int) -> None:
    turned = [0.0, 0.0, 0.0]
    turned[axis] = -3.0  # as told: the data want it back
    fit = fit_of(told(turned_deg=(turned[0], turned[1], turned[2])), seed=3)
    assert fit.mounting_deg == pytest.approx(-np.array(turned), abs=0.3)
    assert fit.verdict == "does not fit" and "turned" in fit.sentence


def test_a_wrong_time_shift_is_found() -> None:
    fit = fit_of(told(shift_s=0.015), seed=4)
    assert fit.time_shift_s == pytest.approx(-0.015, abs=0.002)
    assert fit.verdict == "does not fit" and "ms earlier than told" in fit.sentence


def test_features_that_jump_do_not_make_a_right_calibration_wrong() -> None:
    assert fit_of(CALIBRATION, seed=5, outliers=0.03).verdict == "fits"


def test_nothing_is_known_of_a_drive_of_a_second() -> None:
    check = check_of(CALIBRATION)
    for keyframe in true_keyframes(CALIBRATION, CALIBRATION, 6, 1.0, 1.0, rate_hz=RATE_HZ):
        check.add(keyframe)
    assert check.finish() is None


def test_it_is_the_same_whether_windows_wait_or_not() -> None:
    keyframes = true_keyframes(CALIBRATION, told(focal=1.03), 7, DURATION_S, 1.0, rate_hz=RATE_HZ)
    eager, patient = check_of(told(focal=1.03)), check_of(told(focal=1.03))
    for keyframe in keyframes:
        eager.add(keyframe)
        while eager.work():
            pass
        patient.add(keyframe)
    assert eager.fit is not None  # while the drive goes on
    assert patient.fit is None
    assert eager.finish() == patient.finish()


def test_windows_that_nobody_has_time_for_do_not_pile_up() -> None:
    keyframes = true_keyframes(CALIBRATION, CALIBRATION, 8, DURATION_S, 1.0, rate_hz=RATE_HZ)
    check = check_of(CALIBRATION)
    rounds = 2 + (MAX_WAITING + 1) * WINDOW // len(keyframes)
    for _ in range(rounds):  # each begins anew: nothing links its first keyframe
        for keyframe in keyframes:
            check.add(keyframe)
    assert check.fit is not None  # looked at although nobody asked


def window_that_says(focal: float, turned_deg: float) -> CalibrationInformation:
    error = np.array([np.log(focal), np.radians(turned_deg), 0.0, 0.0, 0.0])
    matrix = np.diag(np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-4]) ** -2.0)
    return CalibrationInformation(matrix, matrix @ error)


def test_no_window_alone_condemns_or_praises_a_calibration() -> None:
    """One window that the machine's load or a person walking through has spoilt says 2.5 degrees, for sure."""
    spoilt, usual = window_that_says(1.0, 2.5), window_that_says(1.0, 0.1)
    for windows in ([spoilt], [usual], [spoilt, usual], [usual, spoilt]):
        fit = combined(windows)
        assert fit is not None and fit.verdict != "does not fit"
    alone, together = combined([usual]), combined([usual] * 3 + [spoilt])
    assert alone is not None and alone.verdict == "not known yet"
    assert together is not None and together.verdict != "does not fit"
    all_turned = combined([window_that_says(1.0, 2.5 + 0.1 * k) for k in range(4)])
    assert all_turned is not None and all_turned.verdict == "does not fit"


def test_a_long_drives_uncertainty_is_as_that_of_windows_by_themselves() -> None:
    rng = np.random.default_rng(3)
    said = [window_that_says(float(np.exp(rng.normal(0, 0.01))), 0.0) for _ in range(400)]
    fit = combined(said)
    assert fit is not None
    assert fit.focal_sigma == pytest.approx(0.01 / np.sqrt(400), rel=0.4)  # of 20 groups: good to a sixth
