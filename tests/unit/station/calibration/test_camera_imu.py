"""How camera and IMU sit on each other, from recordings whose truth is known."""

from __future__ import annotations

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from shared.geometry import so3_log
from station.calibration.camera_imu import calibrate, start
from station.calibration.camera_imu.calibrate import (
    CameraImuCalibration,
    HandheldRecording,
    calibrate_camera_imu,
)
from station.calibration.camera_imu.start import MAX_USED_S, CameraPoses, best_part
from station.calibration.camera_imu.unknowns import MOUNT_POSITION, MOUNT_ROTATION
from station.calibration.target import BoardView, Target
from station.model.frames import ImuBatch
from tests.support.calibration_sessions import ORIGIN_NS, Session, Waving, make_session, without

SMALL = Target("aprilgrid", columns=4, rows=4, square_m=0.036, gap_m=0.0108)
SIGMA_INTRINSICS = np.array([2.0, 2.0, 2.0, 2.0, 0.01, 0.01, 1e-3, 1e-3])


def short_session(
    seed: int = 1, waving: Waving | None = None, corner_noise_px: float = 0.3, made: Target | None = None
) -> Session:
    return make_session(seed, duration_s=12.0, waving=waving, corner_noise_px=corner_noise_px, target=SMALL, made=made)


def calibrated(session: Session, num_images: int = 115) -> CameraImuCalibration:
    recording = HandheldRecording(
        views=session.views,
        num_images=num_images,
        imu=session.imu,
        target=session.target,
        camera=session.told(),
        noise=session.noise,
        gravity=9.81,
        sigma_intrinsics=SIGMA_INTRINSICS,
        notes=[],
    )
    return calibrate_camera_imu(recording, progress=lambda step: None)


@pytest.fixture(scope="module")
def good() -> tuple[Session, CameraImuCalibration]:
    session = short_session()
    return session, calibrated(session)


def test_a_lively_recording_is_accepted(good: tuple[Session, CameraImuCalibration]) -> None:
    assert good[1].reasons == []


@pytest.mark.parametrize(
    ("views", "num_images", "words"),
    [
        (0, 0, "more light"),
        (30, 115, "more light, a sharp lens, go nearer"),
        (36, 36, "36 images of the target in 1. s are too few .* record longer, or at more images a second"),
    ],
)
def test_too_few_images_of_the_target_are_refused_with_what_helps(
    good: tuple[Session, CameraImuCalibration], views: int, num_images: int, words: str
) -> None:
    session, _ = good
    spread = np.linspace(0, len(session.views) - 1, views).astype(int)
    found = calibrated(replace(session, views=[session.views[i] for i in spread]), num_images)
    assert re.search(words, found.reasons[0]) and len(found.reasons) == 1
    assert ("more light" in found.reasons[0]) == (views != 36)


def test_mounting_time_shift_and_line_delay_are_found(good: tuple[Session, CameraImuCalibration]) -> None:
    session, found = good
    results, true = found.results(), session.camera
    T = np.array(results["T_body_cam"])
    assert np.degrees(np.linalg.norm(so3_log(T[:3, :3].T @ true.T_body_cam_matrix[:3, :3]))) < 0.2
    assert np.linalg.norm(T[:3, 3] - true.T_body_cam_matrix[:3, 3]) < 3e-3
    assert abs(results["time_shift_s"] - true.time_shift_s) < 3e-4
    assert abs(results["line_delay_s"] - true.line_delay_s) < 1e-6
    np.testing.assert_allclose(results["gravity"], session.gravity_target, atol=0.05)


def test_the_truth_lies_within_what_the_estimate_claims(good: tuple[Session, CameraImuCalibration]) -> None:
    session, found = good
    solution = found.solution
    assert solution is not None
    T, true = solution.unknowns.camera.T_body_cam_matrix, session.camera.T_body_cam_matrix
    turned = so3_log(true[:3, :3].T @ T[:3, :3])
    assert (np.abs(turned) < 4 * solution.sigma(MOUNT_ROTATION)).all()
    assert (np.abs(T[:3, 3] - true[:3, 3]) < 4 * solution.sigma(MOUNT_POSITION)).all()


def test_noise_is_measured_from_the_residuals(good: tuple[Session, CameraImuCalibration]) -> None:
    solution = good[1].solution
    assert solution is not None
    assert solution.fit.corner_px == pytest.approx(0.3, rel=0.05)
    assert solution.fit.gyro == pytest.approx(good[0].noise.gyro_density * np.sqrt(200.0), rel=0.1)
    assert solution.fit.accel == pytest.approx(good[0].noise.accel_density * np.sqrt(200.0), rel=0.1)


def test_images_without_the_target_are_bridged_by_the_imu() -> None:
    session = short_session(2)
    assert calibrated(without(session, 40, 60)).is_accepted


def silent(session: Session, begin_s: float, seconds: float) -> Session:
    """The IMU's readings of some seconds lost."""
    imu, t_s = session.imu, 1e-9 * (session.imu.t_robot_ns - ORIGIN_NS)
    kept = (t_s < begin_s) | (t_s > begin_s + seconds)
    return replace(session, imu=ImuBatch(imu.t_robot_ns[kept], imu.gyro_imu[kept], imu.accel_imu[kept]))


def test_a_tenth_of_a_second_without_the_imu_is_bridged(good: tuple[Session, CameraImuCalibration]) -> None:
    session = good[0]
    found = calibrated(silent(session, 6.02, 0.1))
    assert found.reasons == []
    assert found.solution is not None
    T, true = found.solution.unknowns.camera.T_body_cam_matrix, session.camera.T_body_cam_matrix
    assert np.degrees(np.linalg.norm(so3_log(T[:3, :3].T @ true[:3, :3]))) < 0.2


def test_an_imu_that_fell_silent_for_long_is_the_reason() -> None:
    assert_only_reason(calibrated(silent(short_session(), 6.0, 1.5)), r"fell silent for 1\.5 s at second 6")


def test_of_a_long_recording_the_part_is_used_in_which_it_turned_about_all_axes() -> None:
    t_s, t_imu_s = np.arange(0.0, 600.0, 0.1), np.arange(0.0, 600.0, 0.01)
    gyro = np.random.default_rng(1).normal(0.0, 0.01, (len(t_imu_s), 3))
    gyro[:20_000, 0] += 3.0 * np.sin(t_imu_s[:20_000])  # faster, but about one axis
    lively = slice(30_000, 36_000)
    gyro[lively] += np.sin(t_imu_s[lively, None] * [1.0, 1.3, 1.7])
    views = [BoardView(f"{t:.1f}", int(1e9 * t), np.arange(4), np.zeros((4, 2))) for t in t_s]
    poses = CameraPoses(t_s, np.tile(np.eye(4), (len(t_s), 1, 1)), np.zeros(len(t_s)), views)
    used = best_part(poses, t_imu_s, gyro)
    assert used.t_s[0] <= 301.0
    assert used.t_s[-1] >= 359.0
    assert np.ptp(used.t_s) <= MAX_USED_S
    assert [view.name for view in used.views] == [f"{t:.1f}" for t in used.t_s]


def test_a_recording_longer_than_is_used_says_which_part_was(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (calibrate, start):
        monkeypatch.setattr(module, "MAX_USED_S", 10.5)
    found = calibrated(short_session())
    assert found.reasons == []
    assert found.solution is not None
    motion = found.solution.unknowns.motion
    assert motion.end_s - motion.start_s < 11.0
    assert re.search(r"used: second \d to 1\d", found.results()["notes"][0])


@pytest.mark.parametrize(
    ("waving", "remedy"),
    [
        (Waving(turn_rad=(0.002, 0.002, 0.002), shake_m=0.001), "wave it faster"),
        (Waving(turn_rad=(0.002, 0.3, 0.002)), "about one axis only .* tilt it up and down and roll it"),
    ],
)
def test_poor_motion_is_refused_with_its_remedy(waving: Waving, remedy: str) -> None:
    found = calibrated(short_session(waving=waving))
    assert found.solution is None
    assert_only_reason(found, remedy)


def test_a_target_of_another_size_is_named_with_its_true_size() -> None:
    printed = Target("aprilgrid", columns=4, rows=4, square_m=0.9 * 0.036, gap_m=0.9 * 0.0108)
    assert_only_reason(calibrated(short_session(made=printed)), r"0\.9.* measure 32\.\d mm, not 36\.0 mm")


def test_a_target_with_other_columns_is_not_taken_for_a_loose_camera() -> None:
    session = short_session()
    other = replace(session, target=replace(SMALL, columns=3, rows=6))
    assert_only_reason(calibrated(other), "not the one in target.yaml")


def test_an_imu_that_turned_otherwise_is_refused() -> None:
    other = replace(short_session(), imu=short_session(5).imu)
    assert_only_reason(calibrated(other), "fasten both to one rigid body")


def test_a_recording_without_an_imu_is_refused() -> None:
    none = ImuBatch(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    assert_only_reason(calibrated(replace(short_session(), imu=none)), "record the IMU as well")


def test_a_target_that_is_rarely_seen_is_refused() -> None:
    assert_only_reason(calibrated(short_session(), num_images=1000), "more light")


def test_a_short_recording_is_refused() -> None:
    session = short_session()
    assert_only_reason(calibrated(replace(session, views=session.views[:60]), num_images=60), "record 30 to 60 s")


def test_a_lens_that_is_not_the_one_of_its_file_is_refused() -> None:
    session = short_session()
    other = msgspec.structs.replace(session.camera, fx=1.06 * session.camera.fx, fy=1.06 * session.camera.fy)
    assert_only_reason(
        calibrated(replace(session, camera=other)), r"f[xy] is 6.*, not 678.* run `station calibrate camera "
    )


def test_corners_far_from_where_they_should_be_are_refused() -> None:
    assert_only_reason(calibrated(short_session(corner_noise_px=1.5)), "focus the lens")


def with_wrong_corners(session: Session, share: float) -> Session:
    """Some corners 6 px beside where they were seen."""
    rng = np.random.default_rng(4)
    views = []
    for view in session.views:
        away = rng.normal(0.0, 1.0, view.corners_px.shape)
        away *= 6.0 / np.linalg.norm(away, axis=1, keepdims=True)
        is_wrong = rng.uniform(size=(len(away), 1)) < share
        views.append(replace(view, corners_px=view.corners_px + is_wrong * away))
    return replace(session, views=views)


def test_what_is_left_over_is_the_length_of_the_residuals(good: tuple[Session, CameraImuCalibration]) -> None:
    assert good[1].results()["rms_px"] == pytest.approx(0.3 * np.sqrt(2.0), rel=0.05)


def test_a_few_wrong_corners_are_left_out() -> None:
    found = calibrated(with_wrong_corners(short_session(), 0.05))
    assert found.reasons == []
    assert found.results()["rms_px"] == pytest.approx(0.3 * np.sqrt(2.0), rel=0.15)
    assert found.solution is not None
    assert found.solution.left_out == pytest.approx(0.05, abs=0.01)


def test_many_wrong_corners_are_a_reason_against_it() -> None:
    found = calibrated(with_wrong_corners(short_session(), 0.25))
    assert any(re.search(r"2[3-7] % of the corners lie far", reason) for reason in found.reasons), found.reasons


def assert_only_reason(found: CameraImuCalibration, pattern: str) -> None:
    assert not found.is_accepted
    assert len(found.reasons) == 1, found.reasons
    assert re.search(pattern, found.reasons[0]), found.reasons
