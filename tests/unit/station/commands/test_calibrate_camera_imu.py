"""`station calibrate camera-imu` over recordings that the simulator rendered."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from robot.simulation.calibration.conduct import Kind
from robot.simulation.calibration.sessions import Session, record_session
from shared.calibration import REFERENCE_CAMERA, REFERENCE_ROBOT
from shared.calibration_yaml import read_calibration
from shared.errors import DataError
from shared.geometry import so3_log
from station.calibration.camera_files import read_camchain
from station.calibration.camera_imu.recording import views_of
from station.calibration.told import told, told_whole
from station.commands.progress import working
from station.datasets import Dataset
from station.main import app
from station.model.frames import ImageFrame
from tests.support.calibration_sessions import TARGET

SECONDS = 13.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Session]:
    folder = tmp_path_factory.mktemp("sessions") / "good"
    return folder, record_session(Kind.CAMERA_IMU, folder, 4, seconds=SECONDS)


def calibrate(folder: Path, out: Path, *options: str) -> tuple[int, str]:
    command = ["calibrate", "camera-imu", str(folder), "--target", str(folder / "target.yaml"), "--out", str(out)]
    result = CliRunner().invoke(app, [*command, *options])
    return result.exit_code, result.stdout or str(result.exception)


def test_a_waved_robot_is_calibrated_from_its_images(recorded: tuple[Path, Session], tmp_path: Path) -> None:
    folder, session = recorded
    out, camchain = tmp_path / "calibration.yaml", tmp_path / "camchain.yaml"
    code, printed = calibrate(folder, out, "--kalibr", str(camchain), "--json")
    assert code == 0, printed
    found, true = json.loads(printed.splitlines()[-1]), session.truth["calibration"]["camera"]
    T, T_true = np.array(found["T_body_cam"]), np.array(true["T_body_cam"]).reshape(4, 4)
    assert np.degrees(np.linalg.norm(so3_log(T[:3, :3].T @ T_true[:3, :3]))) < 0.1
    assert np.linalg.norm(T[:3, 3] - T_true[:3, 3]) < 3e-3
    assert abs(found["time_shift_s"] - true["time_shift_s"]) < 2e-4
    assert abs(found["line_delay_s"] - true["line_delay_s"]) < 5e-7
    away = np.array(found["intrinsics"]) - [true[key] for key in ("fx", "fy", "cx", "cy")]
    sigma = np.array(found["sigma"]["intrinsics"])
    assert (sigma > 0.0).all() and (sigma < 0.003 * true["width"]).all()  # better known than before
    assert (np.abs(away) < 4 * sigma).all() and len(found["sigma"]["distortion"]) == 4
    written = read_calibration(out).camera
    assert written is not None
    assert np.allclose(written.T_body_cam_matrix, T)
    assert written.time_shift_s == found["time_shift_s"]
    kalibrs = read_camchain(camchain)
    assert np.allclose(kalibrs.T_body_cam_matrix, T)
    assert (kalibrs.time_shift_s, kalibrs.line_delay_s) == (written.time_shift_s, written.line_delay_s)


def test_a_recording_without_an_imu_is_refused_and_nothing_written(tmp_path: Path) -> None:
    folder, out = tmp_path / "no-imu", tmp_path / "calibration.yaml"
    record_session(Kind.CAMERA_IMU, folder, 5, "no-imu", seconds=2.0)
    code, printed = calibrate(folder, out, "--json")
    found = json.loads(printed.splitlines()[-1])
    assert code == 2
    assert not found["accepted"]
    assert found["T_body_cam"] is None
    assert "record the IMU as well" in found["reasons"][0]
    assert not out.exists()


def test_a_lens_that_is_a_guess_is_an_error_that_says_what_to_run(
    recorded: tuple[Path, Session], tmp_path: Path
) -> None:
    folder, _ = recorded
    guess = tmp_path / "camera.yaml"
    guess.write_text((folder / "mav0" / "cam0" / "sensor.yaml").read_text() + "approximate: true\n")
    code, printed = calibrate(folder, tmp_path / "calibration.yaml", "--camera", str(guess))
    assert code != 0
    assert "station calibrate camera" in printed


def images_of(width: int, height: int, *more: bytes) -> Dataset:
    """Of a grey wall, and more that are given as they are in their files."""
    wall = cv2.imencode(".png", np.full((height, width), 128, np.uint8))[1].tobytes()
    frames = [ImageFrame(i, 10**8 * i, 0, data, f"{i}.png") for i, data in enumerate((wall, *more))]
    times = np.array([frame.t_robot_ns for frame in frames])
    return Dataset(Path("waved"), "asl", REFERENCE_ROBOT, True, times, lambda: iter(frames))


def test_images_of_another_size_than_the_lens_are_an_error_that_says_what_to_run() -> None:
    with (
        working("reading") as bar,
        pytest.raises(DataError, match=r"has 320x240 pixels.* with 640x480; run `station calibrate camera "),
    ):
        views_of(images_of(320, 240), TARGET, REFERENCE_CAMERA, bar)


def test_a_damaged_image_is_left_out_and_named() -> None:
    with working("reading") as bar:
        views, notes = views_of(images_of(640, 480, b"\xff\xd8 torn"), TARGET, REFERENCE_CAMERA, bar)
    assert views == []
    assert len(notes) == 1
    assert "1 images cannot be read, the first: image 1.png" in notes[0]


CAMCHAIN = """cam0:
  camera_model: pinhole
  intrinsics: [500.0, 501.0, 320.0, 240.0]
  distortion_model: radtan
  distortion_coeffs: [-0.3, 0.1, 0.0, 0.0]
  resolution: [640, 480]
"""
IMU_YAML = """accelerometer_noise_density: 0.01
accelerometer_random_walk: 0.002
gyroscope_noise_density: 0.0003
gyroscope_random_walk: 0.00004
update_rate: 250.0
"""


def test_the_lens_and_the_noise_may_be_files_of_kalibr(tmp_path: Path) -> None:
    camchain, imu = tmp_path / "camchain.yaml", tmp_path / "imu.yaml"
    camchain.write_text(CAMCHAIN)
    imu.write_text(IMU_YAML)
    known = told(REFERENCE_ROBOT, camchain, imu)
    assert known.camera is not None
    assert known.imu is not None
    assert (known.camera.fx, known.camera.width, known.camera.distortion[0]) == (500.0, 640, -0.3)
    assert (known.imu.gyro_density, known.imu.accel_walk, known.imu.rate_hz) == (0.0003, 0.002, 250.0)


def test_a_file_of_noise_that_says_none_is_an_error(tmp_path: Path) -> None:
    imu = tmp_path / "imu.yaml"
    imu.write_text("update_rate: 250.0\n")
    with pytest.raises(DataError, match="says none of gyroscope_noise_density"):
        told(REFERENCE_ROBOT, None, imu)


def test_a_recording_that_says_nothing_of_the_imus_noise_is_noted(tmp_path: Path) -> None:
    folder = tmp_path / "short"
    record_session(Kind.CAMERA_IMU, folder, 5, "too-short", seconds=1.0)
    assert "measures" not in notes_of(folder, tmp_path)
    (folder / "mav0" / "imu0" / "sensor.yaml").write_text("rate_hz: 200\ngyroscope_noise_density: 0.0002\n")
    note = notes_of(folder, tmp_path)
    assert (
        "accelerometer_random_walk" in note
        and "of an IMU that nobody measured; `station calibrate imu` measures" in note
    )
    assert "gyroscope_noise_density" not in note


def notes_of(folder: Path, scratch: Path) -> str:
    _, printed = calibrate(folder, scratch / "calibration.yaml", "--json")
    return " ".join(json.loads(printed.splitlines()[-1])["notes"])


def test_a_camchain_with_its_mounting_is_a_calibration_to_check(tmp_path: Path) -> None:
    camchain = tmp_path / "camchain.yaml"
    mounting = "".join(f"  - {row}\n" for row in np.diag([1.0, -1.0, -1.0, 1.0]).tolist())
    camchain.write_text(f"{CAMCHAIN}  T_cam_imu:\n{mounting}  timeshift_cam_imu: -0.02\n")
    known = told_whole(REFERENCE_ROBOT, camchain)
    assert known.camera is not None and known.imu == REFERENCE_ROBOT.imu
    assert (known.camera.fx, known.camera.time_shift_s, known.camera.T_body_cam_matrix[1, 1]) == (500.0, -0.02, -1.0)
    camchain.write_text(CAMCHAIN)
    with pytest.raises(DataError, match="does not say how the camera is mounted"):
        told_whole(REFERENCE_ROBOT, camchain)
