"""Inertial readings between two poses as one measurement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, so3_log
from station.motion.preintegration import ImuSegment, Preintegration, RolledWay, chain, preintegrate

NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
BIAS = np.array([0.02, -0.01, 0.03, 0.1, -0.2, 0.05])


def segment(num_steps: int, first: int = 0) -> ImuSegment:
    t = 0.005 * np.arange(first, first + num_steps)[:, None]
    gyro = np.sin(t * [3.0, 4.0, 5.0] + [0.0, 1.0, 2.0])
    accel = np.array([0.0, 0.0, 9.8]) + 2.0 * np.sin(t * [7.0, 4.0, 3.0])
    end_ns = (first + num_steps) * 5_000_000
    return ImuSegment(np.full(num_steps, 0.005), gyro, accel, end_ns, gyro[-1], np.ones((num_steps, 6)))


def difference(a: Preintegration, b: Preintegration) -> FloatArray:
    """(9,) from a to b: rotation vector on the right, velocity, position."""
    return np.concatenate([so3_log(a.dR.T @ b.dR), b.dv - a.dv, b.dp - a.dp])


@pytest.mark.parametrize("num_steps", [1, 10, 100])
def test_derivatives_by_the_bias_are_finite_differences(num_steps: int) -> None:
    imu = segment(num_steps)
    mean = preintegrate(imu, BIAS, NOISE)
    h = 1e-5
    for i in range(6):
        ahead, behind = (preintegrate(imu, BIAS + sign * h * np.eye(6)[i], NOISE) for sign in (1.0, -1.0))
        found = difference(behind, ahead) / (2.0 * h)
        by_gyro = mean.dR_by_bias[:, i] if i < 3 else np.zeros(3)
        expected = np.concatenate([by_gyro, mean.dv_by_bias[:, i], mean.dp_by_bias[:, i]])
        assert np.allclose(found, expected, rtol=1e-3, atol=1e-3 * float(np.abs(expected).max()))


def test_covariance_is_what_the_noise_of_each_reading_does() -> None:
    imu = segment(30)
    mean = preintegrate(imu, BIAS, NOISE)
    density = np.repeat([NOISE.gyro_density, NOISE.accel_density], 3)
    P = np.zeros((9, 9))
    for k in range(30):
        for i in range(6):
            sigma = density[i] / np.sqrt(imu.dt_s[k])  # of the mean reading over the step
            off = np.zeros((30, 3))
            off[k, i % 3] = sigma
            moved = replace(imu, gyro=imu.gyro + off) if i < 3 else replace(imu, accel=imu.accel + off)
            d = difference(mean, preintegrate(moved, BIAS, NOISE))
            P += np.outer(d, d)
    sigma = np.sqrt(np.diag(P))
    assert np.allclose(mean.covariance / np.outer(sigma, sigma), P / np.outer(sigma, sigma), atol=0.02)


def test_halves_that_were_integrated_at_other_biases_chain_to_the_whole_at_the_first_ones() -> None:
    later = BIAS + np.array([2e-4, -1e-4, 3e-4, 0.4, -0.3, 0.2])  # a filter learns an accelerometer's bias as it goes
    whole = preintegrate(segment(40), BIAS, NOISE)
    chained = chain(preintegrate(segment(25), BIAS, NOISE), preintegrate(segment(15, 25), later, NOISE))
    assert np.array_equal(chained.bias, BIAS)
    assert np.allclose(difference(whole, chained), 0.0, atol=2e-6)
    moved = whole.bias + np.array([0.0, 0.0, 0.0, -0.2, 0.1, 0.3])
    for expected, found in zip(whole.at(moved), chained.at(moved), strict=True):
        assert np.allclose(expected, found, atol=5e-6)


def test_two_halves_chain_to_the_whole() -> None:
    whole = preintegrate(segment(40), BIAS, NOISE)
    chained = chain(preintegrate(segment(25), BIAS, NOISE), preintegrate(segment(15, 25), BIAS, NOISE))
    assert np.allclose(difference(whole, chained), 0.0, atol=1e-12)
    assert np.allclose(chained.dv_by_bias, whole.dv_by_bias, atol=1e-9)
    assert np.allclose(chained.dp_by_bias, whole.dp_by_bias, atol=1e-9)
    sigma = np.sqrt(np.diag(whole.covariance))
    assert np.allclose(
        chained.covariance / np.outer(sigma, sigma), whole.covariance / np.outer(sigma, sigma), atol=2e-3
    )


def test_ways_of_the_wheels_join_in_the_first_ones_frame() -> None:
    rng = np.random.default_rng(3)
    parts = [preintegrate(segment(20, first), BIAS, NOISE) for first in (0, 20)]
    ways = [rng.normal(size=(3, 2)) for _ in parts]
    a, b = (replace(p, rolled=RolledWay(w, np.diag([1.0, 4.0, 9.0]))) for p, w in zip(parts, ways, strict=True))
    joined = chain(a, b).rolled
    assert joined is not None
    constants = np.array([0.9, 0.1])
    assert np.allclose(joined.by_constants @ constants, ways[0] @ constants + a.dR @ (ways[1] @ constants))
    assert np.trace(joined.covariance) == pytest.approx(28.0)
    assert chain(a, parts[1]).rolled is None and chain(parts[0], b).rolled is None
