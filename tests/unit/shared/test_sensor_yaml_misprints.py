"""Keys that are hardly others than those that are read, mountings by unknown names, and files that are none."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from shared.calibration import REFERENCE_ROBOT
from shared.calibration_yaml import calibration_text, read_calibration, read_imu
from shared.errors import DataError
from shared.sensor_yaml import read_camera, read_yaml
from station.calibration.camera_files import camchain_yaml, read_camera_file

CAMERA = (
    "resolution: [640, 480]\nintrinsics: [500, 500, 320, 240]\ndistortion_model: radtan\n"
    "distortion_coefficients: [0.1, 0, 0, 0]\n"
)


def written(folder: Path, text: str) -> Path:
    path = folder / "file.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("time_shfit_s: 0.02", "there is no key 'time_shfit_s'; write time_shift_s"),
        ("line_dealy_s: 1e-5", "write line_delay_s"),
        (
            "T_BC: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]",
            "'T_BC' is not read; write how the sensor is mounted as T_body_cam",
        ),
    ],
)
def test_a_misprint_is_named_with_what_was_meant(line: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=said):
        read_camera(written(tmp_path, CAMERA + line + "\n"))


@pytest.mark.parametrize("line", ["comment: left", "rostopic: /cam0", "owner: me", "T_cn_cnm1: [1]", "T_BS: null"])
def test_what_others_write_beside_it_is_passed_over(line: str, tmp_path: Path) -> None:
    assert read_camera(written(tmp_path, f"{CAMERA}{line}\n")).fx == 500.0


@pytest.mark.parametrize(("key", "meant"), [("gravty", "gravity"), ("wheel", "wheels"), ("Camera", "camera")])
def test_sections_are_asked_as_well(key: str, meant: str, tmp_path: Path) -> None:
    content = yaml.safe_load(calibration_text(REFERENCE_ROBOT))
    content[key] = content.pop(meant, {"speed": 1.0})
    with pytest.raises(DataError, match=f"write {meant}"):
        read_calibration(written(tmp_path, yaml.safe_dump(content)))


def test_an_imus_keys_and_a_camchains_are_asked_as_well(tmp_path: Path) -> None:
    imu = "gyroscope_noise_density: 1e-3\naccelerometer_noise_densty: 1e-2\n"
    with pytest.raises(DataError, match="write accelerometer_noise_density"):
        read_imu(written(tmp_path, imu))
    assert REFERENCE_ROBOT.camera is not None
    chain = camchain_yaml(REFERENCE_ROBOT.camera)
    with pytest.raises(DataError, match="write timeshift_cam_imu"):
        read_camera_file(written(tmp_path, chain.replace("timeshift_cam_imu", "timeshift_cam_imus")))
    read = read_camera_file(written(tmp_path, chain))
    assert read is not None and read.time_shift_s == REFERENCE_ROBOT.camera.time_shift_s
    assert (read.fx, read.distortion) == (REFERENCE_ROBOT.camera.fx, REFERENCE_ROBOT.camera.distortion)


def test_no_file_a_folder_and_an_empty_file_are_sentences(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"there is no file .*nothing\.yaml$"):
        read_yaml(tmp_path / "nothing.yaml")
    with pytest.raises(DataError, match="cannot be read") as folder:
        read_yaml(tmp_path)
    assert "PosixPath" not in str(folder.value) and "Errno" not in str(folder.value)
    with pytest.raises(DataError, match="holds no `key: value` lines"):
        read_yaml(written(tmp_path, ""))


@pytest.mark.parametrize("inside", ["", "T_BS:\n  rows: 4\n"])
def test_a_key_that_stands_there_twice_is_refused(inside: str, tmp_path: Path) -> None:
    path = tmp_path / "sensor.yaml"
    again = "  rows: 3\n" if inside else "intrinsics: [2, 2, 2, 2]\n"
    path.write_text(f"intrinsics: [1, 1, 1, 1]\n{inside}{again}")
    key = "rows" if inside else "intrinsics"
    with pytest.raises(DataError, match=f"line {4 if inside else 2}: '{key}' stands there twice"):
        read_yaml(path)
