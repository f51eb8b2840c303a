"""GTSAM's factors of keyframes against finite differences."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, so3_exp
from station.motion.preintegration import ImuSegment, Preintegration, preintegrate
from station.slam.mapping.inertial_graph import (
    WHEELS_KEY,
    bias_key,
    inertial_factor,
    pose_key,
    prior_factors,
    velocity_key,
    wheel_factor,
)

pytestmark = pytest.mark.computing

NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
DIMENSIONS = {"x": 6, "v": 3, "b": 6, "w": 2}


def link(rng: np.random.Generator) -> Preintegration:
    n = 30
    accel = rng.normal(size=(n, 3)) + np.array([0.0, 0.0, 9.8])
    segment = ImuSegment(np.full(n, 0.005), rng.normal(size=(n, 3)), accel, 0, np.zeros(3), np.ones((n, 6)))
    return preintegrate(segment, 0.01 * rng.normal(size=6), NOISE)


def states(rng: np.random.Generator) -> gtsam.Values:
    values = gtsam.Values()
    for k in (0, 1):
        values.insert(pose_key(k), gtsam.Pose3(gtsam.Rot3(so3_exp(rng.normal(size=3))), rng.normal(size=3)))
        values.insert(velocity_key(k), rng.normal(size=3))
        values.insert(bias_key(k), 0.01 * rng.normal(size=6))
    values.insert(WHEELS_KEY, np.array([0.95, 0.03]))
    return values


def by_differences(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> FloatArray:
    """The whitened derivative, column by column."""
    columns = []
    for key in factor.keys():  # noqa: SIM118 - GTSAM's
        size = DIMENSIONS[chr(gtsam.symbolChr(key))]
        for i in range(size):
            sides = []
            for step in (1e-6, -1e-6):
                change = gtsam.VectorValues()
                change.insert(key, step * np.eye(size)[i])
                sides.append(-factor.linearize(values.retract(change)).jacobian()[1])
            columns.append((sides[0] - sides[1]) / 2e-6)
    return np.array(columns).T


@pytest.mark.parametrize("seed", range(3))
def test_derivative_of_the_imu_between_keyframes_agrees_with_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor = inertial_factor(0, 1, link(rng), NOISE, 9.81)
    values = states(rng)
    expected = by_differences(factor, values)
    np.testing.assert_allclose(factor.linearize(values).jacobian()[0], expected, atol=1e-6 * np.abs(expected).max())


def test_derivative_of_the_wheels_agrees_with_differences() -> None:
    rng = np.random.default_rng(5)
    factor = wheel_factor(0, rng.normal(size=(3, 2)), np.array([0.1, np.inf, 0.05]), huber=1e9)
    assert factor is not None
    values = states(rng)
    np.testing.assert_allclose(factor.linearize(values).jacobian()[0], by_differences(factor, values), atol=1e-5)


def test_wheels_that_say_nothing_make_no_factor() -> None:
    assert wheel_factor(0, np.zeros((3, 2)), np.full(3, np.inf), huber=2.0) is None


def test_a_path_without_noise_leaves_no_error() -> None:
    rng = np.random.default_rng(1)
    motion = link(rng)
    dR, dv, dp = motion.at(motion.bias)
    R, x, v, t = so3_exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3), motion.duration_s
    fall = np.array([0.0, 0.0, -9.81])
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose3(gtsam.Rot3(R), x))
    values.insert(pose_key(1), gtsam.Pose3(gtsam.Rot3(R @ dR), x + v * t + 0.5 * fall * t * t + R @ dp))
    values.insert(velocity_key(0), v)
    values.insert(velocity_key(1), v + fall * t + R @ dv)
    values.insert(bias_key(0), motion.bias)
    values.insert(bias_key(1), motion.bias)
    assert inertial_factor(0, 1, motion, NOISE, 9.81).error(values) < 1e-9


def test_a_prior_on_tilt_is_about_the_worlds_axes() -> None:
    R = so3_exp(np.array([0.4, -0.2, 1.3]))
    T = np.eye(4)
    T[:3, :3] = R
    sigma = np.array([0.1, 0.2, 0.001, *[1.0] * 12])
    prior = prior_factors(0, T, np.zeros(3), np.zeros(6), sigma)[0]
    for axis in range(3):
        turned = gtsam.Values()
        turned.insert(pose_key(0), gtsam.Pose3(gtsam.Rot3(so3_exp(1e-4 * np.eye(3)[axis]) @ R), np.zeros(3)))
        assert prior.error(turned) == pytest.approx(0.5 * (1e-4 / sigma[axis]) ** 2, rel=1e-3)
