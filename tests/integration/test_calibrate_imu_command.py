"""`station calibrate imu`: from a recording of the simulator, a real one or a spoilt one to the files it writes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robot.simulation.calibration.conduct import Kind
from robot.simulation.calibration.sessions import record_session
from shared.calibration_yaml import read_imu
from station.datasets import open_dataset
from tests.support.inertial_noise import EDGES, FACES, turned
from tests.support.paths import RECORDINGS, ROOT
from tests.support.recordings import record_samples


def calibrate_imu(*options: str | Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "station.main", "calibrate", "imu", *map(str, options)]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_simulated_rest_becomes_an_imu_yaml_with_the_true_noise(tmp_path: Path) -> None:
    record_session(Kind.IMU, tmp_path / "rest", 3, seconds=600.0)
    record_session(Kind.IMU, tmp_path / "motors", 3, seconds=30.0, motors=True)
    out = tmp_path / "imu.yaml"
    done = calibrate_imu(tmp_path / "rest", "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    truth = json.loads((tmp_path / "rest/truth.json").read_text())["calibration"]["imu"]
    names = {"noise_density": "density", "random_walk": "walk"}
    for sensor in ("gyro", "accel"):
        for figure, attribute in names.items():
            found, true = report[f"{sensor}_{figure}"], truth[f"{sensor}_{attribute}"]
            low, high = found["interval"]
            assert low - 0.25 * (high - low) < true < high + 0.25 * (high - low)  # three sigmas
            assert report["used"][f"{sensor}_{figure}"] == pytest.approx(
                true, rel=0.05 if figure == "noise_density" else 1.0
            )
    assert report["accepted"] and report["reasons"] == [] and report["motors"] is None
    assert (tmp_path / "imu.png").read_bytes().startswith(b"\x89PNG")
    used = read_imu(out)
    assert used.gyro_walk == report["used"]["gyro_random_walk"] and used.accel_range == truth["accel_range"]
    # The file serves as the dataset's own.
    (tmp_path / "rest/mav0/imu0/sensor.yaml").write_text(out.read_text())
    assert open_dataset(tmp_path / "rest").calibration.imu == used

    shaken = calibrate_imu(tmp_path / "rest", "--motors", tmp_path / "motors", "--out", out, "--json")
    told = json.loads(shaken.stdout.splitlines()[-1])
    assert told["used"]["accel_noise_density"] > 1.5 * report["used"]["accel_noise_density"]
    assert told["accel_noise_density"] == report["accel_noise_density"]


@pytest.mark.parametrize(
    ("poor", "seconds", "remedy"),
    [("too-short", None, "record 30 minutes"), ("in-hand", 120.0, "lay it on"), ("knocked", 120.0, "leave it alone")],
)
def test_a_poor_recording_is_refused_and_nothing_is_written(
    poor: str, seconds: float | None, remedy: str, tmp_path: Path
) -> None:
    record_session(Kind.IMU, tmp_path / "rest", 3, poor=poor, seconds=seconds)
    done = calibrate_imu(tmp_path / "rest", "--out", tmp_path / "imu.yaml", "--json")
    assert done.returncode == 2
    report = json.loads(done.stdout.splitlines()[-1])
    assert not report["accepted"] and report["used"] is None and remedy in report["reasons"][0]
    assert not (tmp_path / "imu.yaml").exists()


def test_a_recording_of_a_robot_on_all_its_sides_tells_its_accelerometers_errors(tmp_path: Path) -> None:
    """Made by the recorder, of a robot on wheels, which stood on its nose for the longest time."""
    unit = turned(7, np.vstack([FACES, EDGES]))
    report = record_samples(tmp_path / "sides.mcap", unit.imu.gyro_imu, unit.imu.accel_imu, 10_000_000)
    assert not report.error
    done = calibrate_imu(tmp_path / "sides.mcap", "--out", tmp_path / "imu.yaml", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])["accelerometer"]
    for figure, true in (("scale", unit.scale), ("misalignment", unit.angles), ("bias", unit.bias)):
        assert (np.abs(np.array(found[figure]) - true) < 3.0 * np.array(found["sigma"][figure])).all()
    assert max(found["sigma"]["scale"]) < 3e-3 and found["rests"] == 12
    assert "accelerometer misalignment" in done.stderr and (tmp_path / "imu.yaml").is_file()


def test_images_of_a_camera_that_no_file_describes_do_not_matter(tmp_path: Path) -> None:
    record_session(Kind.IMU, tmp_path / "rest", 3, poor="too-short")
    (tmp_path / "rest/mav0/cam0").mkdir(exist_ok=True)
    (tmp_path / "rest/mav0/cam0/sensor.yaml").unlink(missing_ok=True)
    (tmp_path / "rest/mav0/cam0/data.csv").write_text("#timestamp [ns],filename\n1000,1000.jpg\n")
    done = calibrate_imu(tmp_path / "rest", "--out", tmp_path / "imu.yaml", "--json")
    assert done.returncode == 2, done.stderr  # for its length
    assert "record 30 minutes" in json.loads(done.stdout.splitlines()[-1])["reasons"][0]


def test_a_recording_without_an_imu_is_refused_in_a_sentence(tmp_path: Path) -> None:
    record_session(Kind.CAMERA_IMU, tmp_path / "waved", 0, poor="no-imu", seconds=1.0)
    done = calibrate_imu(tmp_path / "waved", "--out", tmp_path / "imu.yaml")
    assert done.returncode == 1 and "holds no IMU samples" in done.stderr and "Traceback" not in done.stderr


def test_an_output_of_another_kind_is_refused_before_any_work(tmp_path: Path) -> None:
    done = calibrate_imu(tmp_path / "no-such-dataset", "--out", tmp_path / "imu.txt")
    assert done.returncode == 1 and "must end in .yaml" in done.stderr


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="needs the real recordings beside the repository")
def test_a_real_drone_that_stands_for_five_seconds_is_refused(tmp_path: Path) -> None:
    done = calibrate_imu(RECORDINGS / "euroc_v1_01_static", "--out", tmp_path / "imu.yaml", "--json")
    assert done.returncode == 2
    assert "lasts 5 s" in json.loads(done.stdout.splitlines()[-1])["reasons"][0]
