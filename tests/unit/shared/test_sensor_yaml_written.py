"""What is written as an ASL folder's sensor.yaml is read back as it was, number by number."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from shared.calibration import REFERENCE_CAMERA, REFERENCE_IMU, CameraCalibration, ImuNoise
from shared.calibration_yaml import camera_sensor_text, imu_sensor_text, read_imu
from shared.errors import DataError
from shared.sensor_yaml import read_camera, read_folder_camera, read_rig, read_yaml

FISHEYE = msgspec.structs.replace(
    REFERENCE_CAMERA, model="equidistant", distortion=(0.1 + 0.2, -1e-17, 0.0, 3.0), is_measured=False
)
ENDLESS = msgspec.structs.replace(REFERENCE_IMU, gyro_range=float("inf"), accel_walk=1e-5)


@pytest.mark.parametrize("camera", [REFERENCE_CAMERA, FISHEYE], ids=["radtan", "guessed fisheye"])
def test_a_camera_is_read_back_as_it_was(camera: CameraCalibration, tmp_path: Path) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(camera_sensor_text(camera, rig="hand-held"))
    assert read_camera(path) == camera
    assert read_rig(read_yaml(path), path) == "hand-held"


def test_a_camera_matrix_as_text_gives_numbers_that_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "camera-intrinsics.txt").write_text("585.0 0.0 320.0\n0.0 584.5 240.0\n0.0 0.0 1.0\n")
    camera = read_folder_camera(tmp_path, lambda: (640, 480))
    assert msgspec.json.decode(msgspec.json.encode(camera), type=CameraCalibration) == camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (585.0, 584.5, 320.0, 240.0)


LENS = "resolution: [640, 480]\nintrinsics: [500, 500, 320, 240]\n"


def test_kalibrs_key_of_the_distortion_is_read(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(LENS + "distortion_model: equidistant\ndistortion_coeffs: [0.1, 0.02, 0.003, 0.0004]\n")
    assert read_camera(path).distortion == (0.1, 0.02, 0.003, 0.0004)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("distortion_model: radtan\n", "distortion_model is radtan without distortion_coefficients"),
        ("distortion_model: equidistant\ndistortion_coefs: [0.1, 0, 0, 0]\n", "without distortion_coefficients"),
        ("model: radtan\ndistortion: [-0.3, 0.1, 0, 0]\n", "in a file it is distortion_coefficients"),
    ],
)
def test_a_lens_without_its_distortion_is_refused(tmp_path: Path, more: str, words: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(LENS + more)
    with pytest.raises(DataError, match=words):
        read_camera(path)


@pytest.mark.parametrize("more", ["", "distortion_model: none\n", "distortion_model: none\ndistortion_coeffs: []\n"])
def test_a_lens_of_no_model_has_no_distortion(tmp_path: Path, more: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(LENS + more)
    assert read_camera(path).distortion == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("imu", [REFERENCE_IMU, ENDLESS], ids=["with ranges", "without"])
def test_an_imu_is_read_back_as_it_was(imu: ImuNoise, tmp_path: Path) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(imu_sensor_text(imu))
    assert read_imu(path) == imu
