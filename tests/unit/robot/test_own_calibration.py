"""What a robot tells of its sensors: what it came with, until a station gives it something else."""

from __future__ import annotations

import errno
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
import yaml

from robot.config import CalibrationConfig, RobotConfig
from robot.own_calibration import FILE, OwnCalibration, calibration_folder, read_own
from shared.calibration import REFERENCE_IMU, REFERENCE_ROBOT, Calibration
from shared.calibration_yaml import calibration_text
from shared.errors import ConfigError, DataError
from shared.geometry import se3, so3_exp


def camera_with(**changes: object) -> Calibration:
    assert REFERENCE_ROBOT.camera is not None
    return msgspec.structs.replace(REFERENCE_ROBOT, camera=msgspec.structs.replace(REFERENCE_ROBOT.camera, **changes))


def turned(angle_rad: float) -> tuple[float, ...]:
    return tuple(se3(so3_exp(np.array([0.1, angle_rad, -0.3])), np.array([0.1, 0.2, 0.3])).ravel().tolist())


MEASURED = camera_with(fx=1003.25, time_shift_s=-0.0123, line_delay_s=2.5e-5, T_body_cam=turned(0.7))


def test_a_calibration_that_is_given_is_told_now_and_after_a_restart(tmp_path: Path) -> None:
    own = OwnCalibration(tmp_path / "own", REFERENCE_ROBOT)
    assert own.current == REFERENCE_ROBOT and not own.origin.can_undo
    own.use(MEASURED)
    assert own.current.camera is not None and MEASURED.camera is not None
    assert own.current.camera.T_body_cam == pytest.approx(MEASURED.camera.T_body_cam, abs=1e-12)
    assert (own.current.imu, own.current.rig) == (MEASURED.imu, "wheels")
    again = OwnCalibration(tmp_path / "own", REFERENCE_ROBOT)
    assert again.current == own.current  # to the last bit: maps ask whether a robot tells the same camera
    assert again.origin == own.origin and "calibration.yaml" in own.origin.source


def test_undo_brings_the_one_before_back_and_undone_twice_is_done(tmp_path: Path) -> None:
    own = OwnCalibration(tmp_path, REFERENCE_ROBOT)
    with pytest.raises(ConfigError, match="nothing to undo"):
        own.undo()
    own.use(MEASURED)
    told = own.current
    own.undo()
    assert own.current == REFERENCE_ROBOT == OwnCalibration(tmp_path, MEASURED).current
    own.undo()
    assert own.current == told == OwnCalibration(tmp_path, REFERENCE_ROBOT).current


def test_without_a_folder_it_is_told_until_the_program_ends() -> None:
    own = OwnCalibration(None, REFERENCE_ROBOT)
    own.use(MEASURED)
    assert own.current == MEASURED and own.origin.can_undo and "until robot-server ends" in own.origin.source
    own.undo()
    assert own.current == REFERENCE_ROBOT


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (camera_with(width=1280, height=720), "1280x720, the camera's have 640x480"),
        (camera_with(cx=700.0), "outside the picture"),
        (msgspec.structs.replace(REFERENCE_ROBOT, rig="hand-held"), "rig is 'wheels'"),
        (
            msgspec.structs.replace(REFERENCE_ROBOT, imu=msgspec.structs.replace(REFERENCE_IMU, gyro_range=1.0)),
            "ranges of the robot's IMU",
        ),
        (msgspec.structs.replace(REFERENCE_ROBOT, camera=None), "one camera, the calibration none"),
        (msgspec.structs.replace(REFERENCE_ROBOT, imu=None), "one imu, the calibration none"),
        (msgspec.structs.replace(REFERENCE_ROBOT, robot_kind="generic"), "'generic' robot"),
    ],
)
def test_numbers_that_cannot_be_this_robots_are_refused_and_change_nothing(
    given: Calibration, words: str, tmp_path: Path
) -> None:
    own = OwnCalibration(tmp_path / "own", REFERENCE_ROBOT)
    with pytest.raises(ConfigError, match=re.escape(words)):
        own.use(given)
    assert own.current == REFERENCE_ROBOT and not own.origin.can_undo and not (tmp_path / "own").exists()


def test_a_folder_that_cannot_be_written_is_named_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")  # root may write whatever its mode: so no read-only folder
    own = OwnCalibration(tmp_path / "file" / "own", REFERENCE_ROBOT)
    assert "set calibration.folder" in own.origin.fixed and str(tmp_path) in own.origin.fixed
    with pytest.raises(ConfigError, match=r"set calibration\.folder"):
        own.use(MEASURED)
    assert own.current == REFERENCE_ROBOT


@pytest.mark.parametrize("is_undo", [False, True])
def test_a_full_disk_or_a_killed_writer_leaves_both_calibrations_as_they_were(
    is_undo: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = OwnCalibration(tmp_path, REFERENCE_ROBOT)
    own.use(camera_with(fx=900.0))
    own.use(MEASURED)
    told, replace = own.current, Path.replace

    def full(self: Path, target: Path) -> Path:
        if target.name == FILE:
            raise OSError(errno.ENOSPC, "No space left on device")
        return replace(self, target)  # what was written before it stays, as a killed writer leaves it

    with monkeypatch.context() as while_full:
        while_full.setattr(Path, "replace", full)
        with pytest.raises(ConfigError, match="No space left"):
            own.undo() if is_undo else own.use(camera_with(fx=800.0))
    assert own.current == told
    again = OwnCalibration(tmp_path, REFERENCE_ROBOT)
    assert again.current == told
    again.undo()
    assert again.current == camera_with(fx=900.0)


@pytest.mark.parametrize(
    "previous", ["", "previous: 3\n", "previous: {rig: wheels}\n", "previous:\n  camera: {resolution: [640, 480]}\n"]
)
def test_a_damaged_earlier_calibration_costs_the_undo_and_no_more(
    previous: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / FILE).write_text(calibration_text(MEASURED) + previous)
    own = OwnCalibration(tmp_path, REFERENCE_ROBOT)
    assert own.current == MEASURED and not own.origin.can_undo
    assert ("there is no undo" in caplog.text) == (previous != "")
    with pytest.raises(ConfigError, match="nothing to undo"):
        own.undo()


def test_an_earlier_calibration_of_other_pictures_is_not_brought_back(tmp_path: Path) -> None:
    smaller = camera_with(width=320, height=240, cx=160.0, cy=120.0)
    own = OwnCalibration(tmp_path, smaller)
    own.use(msgspec.structs.replace(smaller, gravity=9.80665))
    (tmp_path / FILE).write_text(calibration_text(MEASURED, smaller))  # the camera was set to larger pictures since
    assert not OwnCalibration(tmp_path, REFERENCE_ROBOT).origin.can_undo


def test_files_written_by_hand_are_read_and_wrong_ones_name_file_and_key(tmp_path: Path) -> None:
    by_hand = "rig: hand-held\ncamera:\n  resolution: [64, 48]\n  intrinsics: [60, 61, 32, 24]\n"
    (tmp_path / FILE).write_text(by_hand)
    read = read_own(tmp_path)
    assert read is not None and read.camera is not None
    assert (read.camera.fy, read.rig, read.imu) == (61.0, "hand-held", None)
    with pytest.raises(ConfigError, match=f"{FILE}: it is of pictures of 64x48|{FILE}: the robot has one imu"):
        OwnCalibration(tmp_path, REFERENCE_ROBOT)
    for text, words in (("camera: 3\n", "camera must be a section"), ("rig: wheels\n", "neither a camera nor an imu")):
        (tmp_path / FILE).write_text(text)
        with pytest.raises(DataError, match=words):
            read_own(tmp_path)


def test_the_previous_one_is_a_section_of_the_one_file(tmp_path: Path) -> None:
    own = OwnCalibration(tmp_path, REFERENCE_ROBOT)
    own.use(MEASURED)
    assert [path.name for path in tmp_path.iterdir()] == [FILE]
    assert yaml.safe_load((tmp_path / FILE).read_text())["previous"]["camera"]["intrinsics"][0] == 1083.4


def test_the_head_stays_as_it_was_built(tmp_path: Path) -> None:
    own = OwnCalibration(tmp_path, REFERENCE_ROBOT)
    own.use(msgspec.structs.replace(MEASURED, head=None))
    assert own.current.head == REFERENCE_ROBOT.head is not None
    assert OwnCalibration(tmp_path, REFERENCE_ROBOT).current.head == REFERENCE_ROBOT.head


def test_only_a_real_robot_keeps_its_calibration_without_being_told_where() -> None:
    assert calibration_folder("simulated", RobotConfig()) is None
    assert calibration_folder("pi", RobotConfig()) is not None
    chosen = RobotConfig(calibration=CalibrationConfig(folder="/var/lib/robot"))
    assert calibration_folder("simulated", chosen) == calibration_folder("pi", chosen) == Path("/var/lib/robot")
