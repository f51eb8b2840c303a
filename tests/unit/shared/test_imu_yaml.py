"""`imu.yaml`: kalibr's keys, written and read."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import AccelerometerCalibration, ImuNoise
from shared.calibration_yaml import imu_text, read_imu
from shared.errors import DataError
from shared.sensor_yaml import CONSUMER_IMU, read_imu_noise, read_yaml

figure = st.floats(1e-9, 1.0)
KALIBR = """imu0:
  T_i_b:
  - [1.0, 0.0, 0.0, 0.0]
  accelerometer_noise_density: 0.006
  accelerometer_random_walk: 0.0002
  gyroscope_noise_density: 0.0004
  gyroscope_random_walk: 4.0e-06
  model: calibrated
  rostopic: /imu0
  time_offset: 0.0
  update_rate: 225.0
"""


known = st.builds(
    AccelerometerCalibration,
    scale=st.tuples(*[st.floats(0.6, 1.6)] * 3),
    misalignment=st.tuples(*[st.floats(-0.4, 0.4)] * 3),
)


@given(
    figure, figure, figure, figure, st.floats(1.0, 2000.0), st.floats(1.0, 1e3) | st.just(math.inf),
    known | st.just(msgspec.UNSET),
)  # fmt: skip
def test_every_number_is_read_back_as_it_is(
    tmp_path_factory: pytest.TempPathFactory,
    gyro: float,
    accel: float,
    gyro_walk: float,
    accel_walk: float,
    rate: float,
    limit: float,
    accelerometer: AccelerometerCalibration | msgspec.UnsetType,
) -> None:
    imu = ImuNoise(
        gyro_density=gyro,
        accel_density=accel,
        gyro_walk=gyro_walk,
        accel_walk=accel_walk,
        rate_hz=rate,
        gyro_range=limit,
        accel_range=limit,
        accelerometer=accelerometer,
    )
    path = tmp_path_factory.mktemp("imu") / "imu.yaml"
    path.write_text(imu_text(imu))
    assert read_imu(path) == imu
    content = read_yaml(path)
    assert content["update_rate"] == rate and content["rostopic"].startswith("/")
    assert read_imu_noise(path, content) == imu  # as a dataset reads its imu0/sensor.yaml


def test_kalibrs_own_results_are_read(tmp_path: Path) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text(KALIBR)
    imu = read_imu(path)
    assert (imu.gyro_density, imu.gyro_walk, imu.accel_density, imu.accel_walk) == (4e-4, 4e-6, 6e-3, 2e-4)
    assert imu.rate_hz == 225.0 and imu.gyro_range == math.inf


def test_a_word_in_place_of_a_number_is_refused_by_file_and_key(tmp_path: Path) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text("gyroscope_noise_density: small\n")
    with pytest.raises(DataError, match=r"imu\.yaml: gyroscope_noise_density"):
        read_imu(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gyro_noise_density: 0.0003\naccel_noise_density: 0.003\n", "in a file it is gyroscope_noise_density"),
        ("update_rate: 200.0\n", "says none of gyroscope_noise_density"),
        ("gyroscope_noise_density: -0.0003\n", "gyro_density is -0.0003, must be over 0"),
        ("accelerometer_random_walk: 0.0\n", "accelerometer_random_walk is 0, must be over 0"),
        ("gyroscope_noise_density: 0.0003\nrate_hz: 0\n", "rate_hz is 0, must be over 0"),
        ("gyroscope_noise_density: .inf\n", "gyroscope_noise_density must be a number"),
    ],
)
def test_a_file_of_noise_never_becomes_a_consumer_units_without_a_word(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text(text)
    with pytest.raises(DataError, match=words):
        read_imu(path)


def test_a_dataset_may_leave_out_what_nobody_measured(tmp_path: Path) -> None:
    imu = read_imu_noise(tmp_path / "sensor.yaml", {"rate_hz": 100, "gyroscope_noise_density": 0.0})
    assert (imu.gyro_density, imu.rate_hz) == (CONSUMER_IMU["gyro_density"], 100.0)
