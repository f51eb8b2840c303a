"""Wheels are measured between rests: by the board for the way, by the gyroscope for turns."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from robot.simulation.calibration.kind import Kind
from robot.simulation.calibration.sessions import Session, record_session
from shared.calibration import REFERENCE_ROBOT, CameraCalibration, WheelCalibration
from shared.errors import DataError
from shared.geometry import se3, so3_exp, so3_log, transform
from shared.sensor_yaml import read_yaml
from station.calibration.target import Target
from station.calibration.target_file import read_target
from station.calibration.target_page import page_target
from station.calibration.wheels import (
    TOO_FEW_RESTS,
    Move,
    Wheels,
    board_pose,
    board_views,
    calibrate_wheels,
    find_rests,
    fit_factor,
    late,
    pose_before_board,
)
from station.commands.calibrate.wheels import _sentences, report, wheels_section
from station.datasets import Dataset, open_dataset
from station.main import app
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from tests.support.target_images import T_cam_board, photograph, printed_page

S = 1_000_000_000


def measured(folder: Path) -> Wheels:
    return calibrate_wheels(open_dataset(folder), read_target(folder / "target.yaml"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Session]:
    folder = tmp_path_factory.mktemp("wheels") / "session"
    return folder, record_session(Kind.WHEELS, folder, seed=1)


def test_speed_track_and_lag_come_out_of_a_drive_before_a_board(recording: tuple[Path, Session]) -> None:
    folder, session = recording
    found, true = measured(folder), session.truth["wheels"]
    assert found.accepted, found.reasons
    assert found.speed is not None and found.turn is not None
    assert found.lag_s is not None and found.lag_sigma_s is not None
    assert found.speed.value == pytest.approx(true["linear_efficiency"], rel=0.003)
    assert found.turn.value == pytest.approx(true["yaw_efficiency"], rel=0.01)
    assert found.lag_s == pytest.approx(true["lag_s"], rel=0.05)
    assert abs(found.turn.value - true["yaw_efficiency"]) < 3 * found.turn.sigma


def test_the_command_writes_what_the_robot_should_be_told(recording: tuple[Path, Session], tmp_path: Path) -> None:
    folder, session = recording
    out, true = tmp_path / "pi.toml", session.truth["wheels"]
    command = ["calibrate", "wheels", str(folder), "--target", str(folder / "target.yaml"), "--out", str(out)]
    said = CliRunner().invoke(app, [*command, "--full-speed", "0.5", "--track", "0.2", "--json"])
    assert said.exit_code == 0
    answer = json.loads(said.stdout.splitlines()[-1])
    assert answer["full_speed_m_s"] == pytest.approx(0.5 * true["linear_efficiency"], rel=0.003)
    assert answer["track_m"] == pytest.approx(0.2 * true["linear_efficiency"] / true["yaw_efficiency"], rel=0.01)
    assert f"track_m = {answer['track_m']:.4f}" in out.read_text()


@pytest.mark.parametrize(
    ("other", "remedy"),
    [
        ({"tagSize": 0.027}, "correct tagSize"),
        ({"tagCols": 4}, "not the one in target.yaml"),
    ],
)
def test_a_board_that_is_not_the_files_is_refused(
    recording: tuple[Path, Session], tmp_path: Path, other: dict[str, float], remedy: str
) -> None:
    folder, _ = recording
    target, out = tmp_path / "target.yaml", tmp_path / "wheels.yaml"
    target.write_text(json.dumps(read_yaml(folder / "target.yaml") | other))
    out.write_text("as it was")
    said = CliRunner().invoke(app, ["calibrate", "wheels", str(folder), "--target", str(target), "--out", str(out)])
    assert said.exit_code == 2 and remedy in said.stdout
    assert out.read_text() == "as it was"


def test_the_answer_tells_the_lag_and_the_slip_in_the_same_numbers_for_people_and_scripts(
    recording: tuple[Path, Session],
) -> None:
    found = measured(recording[0])
    answer = report(found, None, None)
    said = " ".join(_sentences(answer, Path("wheels.yaml")))
    assert f"lag_s {answer['lag_s']:.4f} s" in said
    more = " ".join(_sentences(answer | {"slip": -0.04}, Path("wheels.yaml")))
    assert "4 % more than its wheels roll" in more and "-4" not in more


def test_without_what_the_robot_drove_with_no_speed_is_made_up(recording: tuple[Path, Session], tmp_path: Path) -> None:
    folder, session = recording
    out, true = tmp_path / "wheels.yaml", session.truth["wheels"]
    command = ["calibrate", "wheels", str(folder), "--target", str(folder / "target.yaml"), "--out", str(out)]
    said = CliRunner().invoke(app, [*command, "--json"])
    assert said.exit_code == 0
    answer = json.loads(said.stdout.splitlines()[-1])
    assert answer["full_speed_m_s"] is answer["track_m"] is answer["sigma"]["track_m"] is None
    assert answer["slip"] == pytest.approx(1 - answer["turn_factor"] / answer["speed_factor"])
    wheels = read_yaml(out)["wheels"]
    assert wheels["speed"] == pytest.approx(true["linear_efficiency"], rel=0.003)
    assert wheels["turn"] == pytest.approx(true["yaw_efficiency"], rel=0.01)
    half = CliRunner().invoke(app, [*command, "--track", "0.2"])
    assert half.exit_code != 0 and "give both --full-speed and --track" in str(half.exception)


def test_factors_that_were_in_use_already_are_part_of_the_new_ones() -> None:
    section = wheels_section({"speed_factor": 0.9, "turn_factor": 1.1}, WheelCalibration(speed=0.5, turn=2.0))
    assert section == "wheels:\n  speed: 0.4500\n  turn: 2.2000\n"


def turning(without_imu_s: Sequence[tuple[float, float]] = (), frames: Sequence[ImageFrame] = ()) -> Dataset:
    """Six turns of 2 s at 1 rad/s, of which 80 % are done, each after 2 s of rest; the IMU is silent in some spans."""
    drive = [DriveSample(k * 2 * S, 0.0, float(k % 2)) for k in range(13)]
    t_s = np.arange(0.0, 26.0, 0.01)
    for begin, end in without_imu_s:
        t_s = t_s[(t_s < begin) | (t_s >= end)]
    yaw_rate = np.where(t_s // 2 % 2 == 1, 0.8, 0.0)
    gyro = np.stack([np.zeros_like(t_s), np.zeros_like(t_s), yaw_rate + 0.01], axis=1)
    imu = ImuBatch(np.round(t_s * 1e9).astype(np.int64), gyro, np.tile([0.0, 0.0, 9.81], (len(t_s), 1)))
    times = np.array([frame.t_robot_ns for frame in frames], dtype=np.int64)
    return Dataset(Path("turning"), "asl", REFERENCE_ROBOT, True, times, lambda: iter(frames), imu, drive)


CHESSBOARD = Target("chessboard", 9, 6, 0.025)


@pytest.mark.parametrize("silent", [(8.5, 9.9), (8.4, 10.1), (8.0, 10.0), (5.0, 7.0), (0.0, 1.5), (25.0, 26.0)])
def test_turns_are_measured_where_the_imu_was_not_silent(silent: tuple[float, float]) -> None:
    found = calibrate_wheels(turning([silent]), CHESSBOARD)
    assert found.turn is not None
    assert found.turn.value == pytest.approx(0.8, rel=0.01)
    assert found.turn.moves >= 4


def test_where_samples_are_missing_the_refusal_names_them() -> None:
    found = calibrate_wheels(turning([(4.5, 5.5), (8.5, 9.5), (12.5, 13.5), (16.5, 17.5)]), CHESSBOARD)
    assert found.turn is None
    assert "Samples of the IMU are missing" in found.reasons[0]
    silent = calibrate_wheels(turning([(0.5, 25.5)]), CHESSBOARD)
    assert "Samples of the IMU are missing" in silent.reasons[0]


def test_a_drive_that_is_too_short_is_told_how_long_and_with_which_rests() -> None:
    begun = turning()
    found = calibrate_wheels(replace(begun, drive=[DriveSample(0, 0.0, 1.0)]), CHESSBOARD)
    assert found.reasons == (TOO_FEW_RESTS,) and "record a minute, and pause two seconds" in TOO_FEW_RESTS


def test_a_guessed_lens_is_refused() -> None:
    data = turning()
    assert data.calibration.camera is not None
    guess = msgspec.structs.replace(data.calibration.camera, is_measured=False)
    guessed = replace(data, calibration=msgspec.structs.replace(data.calibration, camera=guess))
    with pytest.raises(DataError, match="station calibrate camera"):
        calibrate_wheels(guessed, CHESSBOARD)


def pictures(images: Sequence[bytes]) -> list[ImageFrame]:
    """At 10 Hz from the beginning of the third rest on."""
    return [ImageFrame(k, 9 * S + k * S // 10, 0, image, f"{k}.jpg") for k, image in enumerate(images)]


def test_a_damaged_picture_is_passed_over() -> None:
    found = calibrate_wheels(turning(frames=pictures([b"damaged"])), CHESSBOARD)
    assert found.turn is not None


def test_a_part_of_a_chessboard_tells_no_pose() -> None:
    target = page_target("chessboard", "A4")
    camera = CameraCalibration(
        width=752, height=480, fx=460.0, fy=458.0, cx=367.0, cy=248.0, distortion=(-0.28, 0.07, 2e-4, 0.0)
    )
    seen = {}
    for name, aside in (("whole", 0.0), ("part", -0.8)):
        T = T_cam_board(target, np.array([0.2, -0.2, 0.0]), 0.3, (aside, 0.0))
        grey = photograph(printed_page(target), camera, T)
        encoded = [cv2.imencode(".png", grey)[1].tobytes()] * 3
        views = board_views(iter(pictures(encoded)), camera, target, [(8 * S, 10 * S)], lambda: None)[0]
        seen[name] = board_pose(views, camera, target)
    assert seen["whole"] is not None
    assert seen["part"] is None


def test_a_gyroscope_whose_scale_is_off_as_its_data_sheet_allows_is_within_three_sigmas() -> None:
    data = turning()
    assert data.imu is not None
    scaled = replace(data, imu=replace(data.imu, gyro_imu=1.03 * data.imu.gyro_imu))
    found = calibrate_wheels(scaled, CHESSBOARD).turn
    assert found is not None
    assert abs(found.value - 0.8) < 3.1 * found.sigma
    assert not any("tell only to" in reason for reason in calibrate_wheels(scaled, CHESSBOARD).reasons)


@pytest.mark.parametrize(
    ("poor", "remedy"),
    [
        ("no-rests", "pause two seconds"),
        ("no-drives", "drive to and fro"),
        ("no-turns", "turn on the spot"),
    ],
)
def test_a_poor_drive_is_refused_with_what_to_do(tmp_path: Path, poor: str, remedy: str) -> None:
    record_session(Kind.WHEELS, tmp_path / "session", seed=0, poor=poor)
    assert any(remedy in reason for reason in measured(tmp_path / "session").reasons)


def test_a_refused_drive_writes_nothing(tmp_path: Path) -> None:
    folder, out = tmp_path / "session", tmp_path / "pi.toml"
    record_session(Kind.WHEELS, folder, seed=0, poor="too-short")
    command = ["calibrate", "wheels", str(folder), "--target", str(folder / "target.yaml"), "--out", str(out)]
    said = CliRunner().invoke(app, command)
    assert said.exit_code == 2
    assert "refused" in said.stdout
    assert not out.exists()


def test_a_drive_without_imu_is_named(tmp_path: Path) -> None:
    record_session(Kind.WHEELS, tmp_path / "session", seed=0, poor="no-imu", seconds=4.0)
    with pytest.raises(DataError, match="no IMU"):
        measured(tmp_path / "session")


def test_rests_begin_when_the_motion_has_died_away_and_end_with_the_next_command() -> None:
    drive = [
        DriveSample(0, 0.0, 0.0),
        DriveSample(2 * S, 0.2, 0.0),
        DriveSample(3 * S, 0.2, 0.0),
        DriveSample(4 * S, 0.0, 0.0),
        DriveSample(5 * S, 0.0, 0.0),
        DriveSample(7 * S, 0.0, 1.0),
        DriveSample(8 * S, 0.0, 0.0),
        DriveSample(round(8.5 * S), 0.0, 1.0),
        DriveSample(9 * S, 0.0, 0.0),
    ]
    assert find_rests(drive, 12 * S) == [(0, 2 * S), (round(4.7 * S), 7 * S), (round(9.7 * S), 12 * S)]


def test_two_lags_in_a_row_answer_a_step_as_their_equations_say() -> None:
    lag_s, period_s = 0.1, 0.005
    t_s = period_s * np.arange(200)
    expected = 1 - (1 + t_s / lag_s) * np.exp(-t_s / lag_s)  # x' = (u - x) / lag, y' = (x - y) / lag
    np.testing.assert_allclose(late(np.ones(200), lag_s, period_s), expected, atol=1e-9)


def test_three_sigmas_of_few_moves_hold_as_often_as_they_say() -> None:
    rng = np.random.default_rng(5)
    outside = 0
    for _ in range(2000):
        ratio = 0.8 * (1 + 0.01 * rng.standard_normal(4))
        factor = fit_factor([(2.0, 2.0 * r) for r in ratio], 0.0)
        assert factor is not None
        outside += abs(factor.value - 0.8) > 3 * factor.sigma
    assert outside <= 16  # 0.27 % of 2000 are 5.4


def test_two_moves_are_too_few_to_contradict_each_other() -> None:
    assert fit_factor([(1.0, 0.9), (1.0, 0.9)], 0.0) is None


def test_an_arc_is_neither_a_drive_nor_a_turn() -> None:
    arc = Move(0, S, 1.0, 1.0, 0.3, 0.3, 0.9, 0.8)
    assert not arc.is_drive and not arc.is_turn
    assert Move(0, S, 1.0, 0.0, 0.3, 0.0, 0.9, 0.0).is_drive
    assert Move(0, S, 0.0, 1.0, 0.0, 0.3, None, 0.8).is_turn


@pytest.mark.parametrize("turned_deg", [0.0, 1e-3, 0.5, 30.0])
def test_a_board_straight_before_the_camera_tells_where_that_stands(turned_deg: float) -> None:
    target, rng = Target("aprilgrid", 6, 6, 0.034, gap_m=0.0102), np.random.default_rng(5)
    R = so3_exp(np.radians([0.0, turned_deg, 0.0])) @ np.diag([1.0, -1.0, -1.0])
    T_cam_board = se3(R, np.array([-0.1, 0.1, 1.5]))
    p_cam = transform(T_cam_board, target.corners)
    focal = 1000.0
    rays = p_cam[:, :2] / p_cam[:, 2:] + rng.normal(0.0, 0.2 / focal, (len(p_cam), 2))
    found = pose_before_board(target.corners, rays, 2.0 / focal)
    assert found is not None
    off = found @ T_cam_board
    assert abs(off[2, 3]) < 0.01 and np.linalg.norm(so3_log(off[:3, :3])) < np.radians(3.0)
