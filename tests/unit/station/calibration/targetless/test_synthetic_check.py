"""A check without a target, from corners and inertial readings whose truth is known, up to what is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from shared.calibration import CameraCalibration
from shared.geometry import so3_log
from station.calibration.targetless import check
from station.calibration.targetless.check import CalibrationCheck, LivelyRecording, check_calibration
from tests.support.calibration_sessions import IMU_MARGIN_S, ORIGIN_NS
from tests.support.hand_held import knocked
from tests.support.lively_sessions import LivelySession, make_lively_session


class Silent:
    def step(self, description: str, total: int | None = None) -> None: ...
    def advance(self) -> None: ...


Check = Callable[[CameraCalibration], CalibrationCheck]


@pytest.fixture(scope="module")
def session() -> LivelySession:
    return make_lively_session(7)


@pytest.fixture
def checked(session: LivelySession, monkeypatch: pytest.MonkeyPatch) -> Check:
    """Of what corners in images would be followed to, the rest is estimated as ever."""
    since_first_reading = replace(session.seen, t_s=session.seen.t_s + IMU_MARGIN_S)
    monkeypatch.setattr(check, "follow", lambda *_: since_first_reading)
    times_ns = ORIGIN_NS + np.round(1e9 * session.seen.t_s).astype(np.int64)

    def told(camera: CameraCalibration) -> CalibrationCheck:
        recording = LivelyRecording(times_ns, list, session.imu, camera, session.noise, gravity=9.81)
        return check_calibration(recording, Silent())

    return told


def test_a_knocked_calibration_is_repaired_within_its_sigmas(session: LivelySession, checked: Check) -> None:
    found, true = checked(knocked(session.camera, seed=1)), session.camera
    assert found.is_accepted, found.reasons
    assert found.fits is False
    T, T_true = found.repaired.T_body_cam_matrix, true.T_body_cam_matrix
    turned = np.degrees(so3_log(T_true[:3, :3].T @ T[:3, :3]))
    assert np.linalg.norm(turned) < 0.2
    assert np.linalg.norm(T[:3, 3] - T_true[:3, 3]) < 5e-3
    assert abs(found.repaired.time_shift_s - true.time_shift_s) < 5e-4
    sigma = {quantity.key: quantity.sigma for quantity in found.quantities}
    assert (np.abs(turned) < 3 * sigma["rotation_deg"]).all()
    assert (np.abs(T[:3, 3] - T_true[:3, 3]) < 3 * sigma["translation_m"]).all()
    assert found.solution is not None and found.solution.rms_px < 0.5  # 0.28 are noise


def test_a_right_calibration_fits_and_stays(session: LivelySession, checked: Check) -> None:
    found = checked(session.camera)
    assert found.is_accepted, found.reasons
    assert found.fits
    assert found.repaired == session.camera


def test_a_wrong_time_shift_alone_is_all_that_does_not_fit(session: LivelySession, checked: Check) -> None:
    late = msgspec.structs.replace(session.camera, time_shift_s=session.camera.time_shift_s + 0.01)
    assert [quantity.key for quantity in checked(late).quantities if not quantity.fits] == ["time_shift_s"]
