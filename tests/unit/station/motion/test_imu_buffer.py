"""How noisy the IMU is taken to be, from what it reads; gaps and readings at its range are counted."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from shared.calibration import AccelerometerCalibration, ImuNoise
from shared.geometry import FloatArray
from station.model.frames import ImuBatch
from station.motion.imu_buffer import IN_THE_AIR, ON_WHEELS, ImuBuffer, Shaking

NOISE = ImuNoise(gyro_density=2e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
T_S = np.arange(800) / NOISE.rate_hz


def noise_scale(gyro: FloatArray, accel: FloatArray, shaking: Shaking = ON_WHEELS, is_link: bool = False) -> FloatArray:
    """(6,) mean over the stream of what the segments between pictures say."""
    buffer = ImuBuffer(NOISE, shaking)
    t_ns = np.rint(T_S * 1e9).astype(np.int64)
    buffer.add(ImuBatch(t_ns, gyro, accel))
    segments = [buffer.segment(int(t), int(t) + 50_000_000, is_link) for t in t_ns[200:-20:20]]
    return np.asarray(np.mean([s.noise_scale[0] for s in segments], axis=0))


def white(seed: int, density: float) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, density * np.sqrt(NOISE.rate_hz), (len(T_S), 3))


def test_white_noise_is_measured_as_what_it_is() -> None:
    scale = noise_scale(white(1, 3.0 * NOISE.gyro_density), white(2, 5.0 * NOISE.accel_density))
    assert scale.reshape(2, 3).mean(axis=1) == pytest.approx([3.0, 5.0], rel=0.1)


def test_on_wheels_what_shakes_one_axis_is_noise_of_that_axis_only() -> None:
    accel = white(5, NOISE.accel_density) * [1.0, 1.0, 6.0]
    scale = noise_scale(white(6, NOISE.gyro_density), accel)
    assert scale == pytest.approx([1.0, 1.0, 1.0, 1.0, 1.0, 6.0], rel=0.2)
    in_the_air = noise_scale(white(6, NOISE.gyro_density), accel, IN_THE_AIR)[3:]
    assert in_the_air == pytest.approx(np.full(3, np.sqrt(1.0 + 0.01 * (38.0 / 3.0 - 1.0))), rel=0.05)


def test_in_the_air_more_of_the_shaking_is_noise_between_keyframes_than_from_picture_to_picture() -> None:
    gyro, accel = white(7, 20.0 * NOISE.gyro_density), white(8, NOISE.accel_density)
    to_next, between = (noise_scale(gyro, accel, IN_THE_AIR, is_link) for is_link in (False, True))
    assert to_next[:3] == pytest.approx(np.full(3, np.sqrt(1.0 + (0.1 * 20.0) ** 2)), rel=0.1)
    assert between[:3] == pytest.approx(np.full(3, np.sqrt(1.0 + (0.2 * 20.0) ** 2)), rel=0.1)
    assert between[3:] == pytest.approx(np.ones(3), abs=0.05)  # nothing shakes the accelerometer
    assert np.array_equal(noise_scale(gyro, accel), noise_scale(gyro, accel, is_link=True))  # on wheels


def test_a_resting_sensor_has_the_noise_of_its_data_sheet() -> None:
    scale = noise_scale(white(3, NOISE.gyro_density), white(4, NOISE.accel_density))
    assert (scale >= 1.0).all() and scale == pytest.approx(np.ones(6), abs=0.15)


def test_motion_is_no_noise() -> None:
    swing = np.sin(2 * np.pi * 0.7 * T_S)[:, None] * np.ones(3)  # as fast as a small robot starts and turns
    assert noise_scale(0.8 * swing, 2.0 * swing) == pytest.approx(np.ones(6), abs=0.2)


def test_what_alternates_between_samples_averages_out() -> None:
    buzz = np.where(np.arange(len(T_S)) % 2 == 0, 1.0, -1.0)[:, None] * np.ones(3)
    assert noise_scale(0.1 * buzz, buzz) == pytest.approx(np.ones(6), abs=1e-9)


def test_readings_become_forces_and_those_at_the_range_are_still_seen_as_such() -> None:
    known = AccelerometerCalibration(scale=(0.9, 1.0, 1.0), misalignment=(0.02, 0.0, 0.0))
    buffer = ImuBuffer(msgspec.structs.replace(NOISE, accel_range=20.0, accelerometer=known))
    t_ns = np.rint(T_S * 1e9).astype(np.int64)
    accel = np.tile([20.0, 5.0, 9.0], (len(T_S), 1))
    buffer.add(ImuBatch(t_ns, np.zeros((len(T_S), 3)), accel))
    segment = buffer.segment(1_000_000_000, 1_100_000_000)
    expected = [18.0 - 0.02 * 5.0, 5.0, 9.0]
    assert segment.accel == pytest.approx(np.tile(expected, (len(segment.accel), 1)))
    assert buffer.samples(1_000_000_000, 1_100_000_000).accel_imu[0] == pytest.approx(expected)
    assert buffer.counts.saturated == len(T_S) and (segment.noise_scale >= 10.0).all()


def test_a_gap_and_a_reading_at_the_range_are_counted_once_however_often_they_are_integrated() -> None:
    noise = msgspec.structs.replace(NOISE, gyro_range=4.0, accel_range=70.0)
    buffer = ImuBuffer(noise)
    t_ns = np.rint(T_S * 1e9).astype(np.int64)
    keep = (T_S < 2.0) | (T_S >= 2.1)
    gyro, accel = white(3, NOISE.gyro_density), white(4, NOISE.accel_density)
    gyro[200, 1] = -4.0
    for part in np.array_split(np.flatnonzero(keep), 300):
        buffer.add(ImuBatch(t_ns[part], gyro[part], accel[part]))
    for begin_ns in range(500_000_000, 2_050_000_000, 50_000_000):
        buffer.segment(begin_ns, begin_ns + 500_000_000)
    assert (buffer.counts.gaps, buffer.counts.saturated) == (1, 1)
    assert buffer.counts.longest_gap_s == pytest.approx(0.105)
    widest = buffer.segment(1_900_000_000, 2_300_000_000)
    assert widest.noise_scale.max() > 100.0  # the gap still counts as what it is
