"""What a recording of an inertial unit at rest becomes, good and poor."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from shared.calibration import REFERENCE_IMU
from shared.geometry import FloatArray
from shared.sensor_yaml import CONSUMER_IMU
from station.calibration.imu.allan import allan_deviation
from station.calibration.imu.calibrate import ImuCalibration, calibrate_imu, used_walk
from station.calibration.imu.noise_fit import Estimate, Noise
from station.calibration.imu.sensor import SensorNoise
from station.model.frames import ImuBatch
from tests.support.inertial_noise import (
    ACCEL,
    FLICKERING_ACCEL,
    FLICKERING_GYRO,
    GYRO,
    QUIET_ACCEL,
    QUIET_GYRO,
    UP,
    TrueNoise,
    axis,
    resting,
)

pytestmark = pytest.mark.computing
RATE = 100.0


@cache
def at_rest(minutes: float) -> ImuBatch:
    return resting(5, 60 * minutes, RATE)


def shaken(imu: ImuBatch, gyro: FloatArray | float = 0.0, accel: FloatArray | float = 0.0) -> ImuBatch:
    return dataclasses.replace(imu, gyro_imu=imu.gyro_imu + gyro, accel_imu=imu.accel_imu + accel)


def seconds_of(imu: ImuBatch) -> FloatArray:
    return 1e-9 * (imu.t_robot_ns - imu.t_robot_ns[0])


def sensors(found: ImuCalibration) -> tuple[SensorNoise, SensorNoise]:
    assert found.gyro is not None and found.accel is not None
    return found.gyro, found.accel


@pytest.mark.parametrize(
    ("gyro", "accel"), [(GYRO, ACCEL), (FLICKERING_GYRO, FLICKERING_ACCEL), (QUIET_GYRO, QUIET_ACCEL)]
)
def test_half_an_hour_tells_all_four_figures(gyro: TrueNoise, accel: TrueNoise) -> None:
    found = calibrate_imu(resting(5, 1800.0, RATE, gyro, accel))
    assert found.accepted and found.reasons == () and found.notes == ()
    for sensor, truth in zip(sensors(found), (gyro, accel), strict=True):
        assert sensor.noise.density.value == pytest.approx(truth.density, rel=0.03)
        assert sensor.noise.walk.value == pytest.approx(truth.walk, rel=0.25)
        assert sensor.noise.walk.low < truth.walk < sensor.noise.walk.high
    assert found.gravity == pytest.approx(9.81, abs=0.3)


def test_two_minutes_tell_the_white_noise_and_the_walk_is_a_consumer_units() -> None:
    found = calibrate_imu(resting(5, 120.0, RATE, GYRO, ACCEL))
    assert found.accepted and found.used is not None
    gyro, accel = sensors(found)
    assert gyro.noise.walk.low == accel.noise.walk.low == 0.0
    assert found.used.gyro_walk == min(CONSUMER_IMU["gyro_walk"], gyro.noise.walk.high)
    assert found.used.accel_walk == min(CONSUMER_IMU["accel_walk"], accel.noise.walk.high)
    assert "only an upper limit" in found.notes[0]


def test_what_the_estimation_is_told_covers_the_flicker_it_does_not_model() -> None:
    """Within a tenth of the Allan deviation at every averaging time, and not far above it where flicker reigns."""
    noise = Noise(*(Estimate(value, 0.9 * value, 1.1 * value) for value in (1.7e-4, 6e-5, 1.9e-5)))
    found = calibrate_imu(at_rest(30))
    gyro = dataclasses.replace(sensors(found)[0], noise=noise, axes=(noise, noise, noise))
    N, K = 1.7e-4, used_walk(gyro, 1.0)
    tau = np.geomspace(0.01, 3000.0, 200)
    told = N**2 / tau + K**2 * tau / 3.0
    assert (told >= 0.82 * noise.allan_variance(tau)).all()
    assert (told <= 5.0 * noise.allan_variance(tau)).all()


def test_a_knock_is_cut_out_and_named() -> None:
    imu = at_rest(10)
    knock = (np.abs(seconds_of(imu) - 200.2) < 0.1)[:, None] * np.random.default_rng(0).normal(0.0, 3.0, (len(imu), 3))
    found = calibrate_imu(shaken(imu, gyro=0.1 * knock, accel=knock))
    assert found.accepted
    assert "moved 1 times (200 s)" in found.notes[0]
    assert sensors(found)[1].noise.density.value == pytest.approx(ACCEL.density, rel=0.03)


def test_a_humming_fan_is_named_and_left_out() -> None:
    imu = at_rest(10)
    hum = 1e-3 * np.sin(2 * np.pi * 7.3 * seconds_of(imu))[:, None]
    found = calibrate_imu(shaken(imu, gyro=hum))
    gyro, _ = sensors(found)
    assert found.accepted and gyro.foreign_hz[0] == pytest.approx(7.3, rel=0.05)
    assert gyro.noise.density.value == pytest.approx(GYRO.density, rel=0.03)
    assert gyro.foreign_rms == pytest.approx(1e-3 / np.sqrt(2), rel=0.2)
    assert "the gyroscope was shaken at 7." in " ".join(found.notes)


def test_warming_up_is_named_and_not_taken_for_a_random_walk() -> None:
    imu = resting(7, 1800.0, RATE, QUIET_GYRO, QUIET_ACCEL)
    warming = 0.02 * np.exp(-seconds_of(imu) / 300.0)[:, None]
    found = calibrate_imu(shaken(imu, gyro=warming))
    gyro, _ = sensors(found)
    assert gyro.drifts and "the gyroscope drifted" in " ".join(found.notes)
    assert gyro.noise.walk.low < QUIET_GYRO.walk < gyro.noise.walk.high


def test_a_unit_that_filters_its_readings_is_measured_below_its_filter() -> None:
    imu = at_rest(10)
    filtered = lfilter([0.1], [1.0, -0.9], imu.gyro_imu, axis=0)[200:]
    found = calibrate_imu(ImuBatch(imu.t_robot_ns[200:], filtered, imu.accel_imu[200:]))
    gyro, _ = sensors(found)
    assert "filters its own readings" in " ".join(found.notes)
    assert gyro.noise.density.value == pytest.approx(GYRO.density, rel=0.1)


def test_the_noisiest_axis_decides_what_is_told() -> None:
    imu = at_rest(10)
    loud = np.random.default_rng(1).standard_normal(len(imu)) * 3 * GYRO.density * np.sqrt(RATE)
    found = calibrate_imu(shaken(imu, gyro=np.outer(loud, [0.0, 0.0, 1.0])))
    assert found.used is not None
    assert found.used.gyro_density == pytest.approx(math.sqrt(10.0) * GYRO.density, rel=0.05)
    assert "axes are unequal" in " ".join(found.notes)


def test_running_motors_raise_what_is_told() -> None:
    rng = np.random.default_rng(1)
    motors = resting(6, 30.0, RATE)
    motors = shaken(motors, accel=0.3 * rng.standard_normal((len(motors), 3)))
    found = calibrate_imu(at_rest(2), motors=motors)
    assert found.used is not None and found.shaking is not None
    gyro, accel = found.shaking
    assert accel.density == pytest.approx(0.3 / np.sqrt(RATE), rel=0.1)
    assert gyro.density == pytest.approx(GYRO.density, rel=0.1)
    assert found.used.accel_density == accel.density


REFUSED: dict[str, tuple[Callable[[ImuBatch], ImuBatch], str]] = {
    "too short": (lambda imu: cut(imu, 0.0, 30.0), "lasts 30 s"),
    "in a hand": (
        lambda imu: shaken(imu, gyro=0.3 * np.sin(0.7 * seconds_of(imu))[:, None]),
        "lay still for",
    ),
    "on a humming machine": (
        lambda imu: shaken(imu, accel=0.05 * np.sin(2 * np.pi * 7.0 * seconds_of(imu))[:, None]),
        "something shook the accelerometer all the time",
    ),
    "gravity taken off": (lambda imu: shaken(imu, accel=-UP), "gravity included"),
    "in units of g": (lambda imu: dataclasses.replace(imu, accel_imu=imu.accel_imu / 9.81), "must be in m/s^2"),
    "in degrees": (lambda imu: dataclasses.replace(imu, gyro_imu=np.degrees(imu.gyro_imu)), "must be in rad/s"),
    "on a turntable": (lambda imu: shaken(imu, gyro=0.5), "must not turn"),
    "many samples lost": (lambda imu: thinned(imu), "of the samples were lost"),
    "a dead axis": (
        lambda imu: dataclasses.replace(imu, gyro_imu=imu.gyro_imu * [1.0, 1.0, 0.0]),
        "an axis of the gyroscope hardly changes",
    ),
    "coarse steps": (
        lambda imu: dataclasses.replace(imu, accel_imu=np.round(imu.accel_imu / 0.5) * 0.5),
        "an axis of the accelerometer hardly changes",
    ),
    "saturated": (
        lambda imu: dataclasses.replace(imu, accel_imu=np.minimum(imu.accel_imu + 30.0, 39.24)),
        "end of the sensor's range",
    ),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_a_poor_recording_is_refused_with_the_remedy(mistake: str) -> None:
    spoil, reason = REFUSED[mistake]
    found = calibrate_imu(spoil(at_rest(2)), REFERENCE_IMU)
    assert not found.accepted
    assert any(reason in one for one in found.reasons), found.reasons


def cut(imu: ImuBatch, begin_s: float, end_s: float) -> ImuBatch:
    keep = (seconds_of(imu) >= begin_s) & (seconds_of(imu) < end_s)
    return ImuBatch(imu.t_robot_ns[keep], imu.gyro_imu[keep], imu.accel_imu[keep])


def thinned(imu: ImuBatch) -> ImuBatch:
    keep = np.random.default_rng(0).random(len(imu)) > 0.05
    return ImuBatch(imu.t_robot_ns[keep], imu.gyro_imu[keep], imu.accel_imu[keep])


def test_of_twenty_good_recordings_none_is_refused() -> None:
    assert all(calibrate_imu(resting(seed, 120.0, 50.0)).accepted for seed in range(100, 120))


def test_the_allan_deviation_is_the_noises_own() -> None:
    values = axis(np.random.default_rng(0), 400_000, RATE, FLICKERING_GYRO)
    curve = allan_deviation([values], RATE)
    noise = Noise(
        *(Estimate(v, v, v) for v in (FLICKERING_GYRO.density, FLICKERING_GYRO.instability, FLICKERING_GYRO.walk))
    )
    expected = np.sqrt(noise.allan_variance(curve.tau_s))
    assert np.mean((curve.low <= expected) & (expected <= curve.high)) > 0.8
    short = curve.tau_s < 10.0
    np.testing.assert_allclose(curve.deviation[short], expected[short], rtol=0.05)
