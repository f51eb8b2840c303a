"""Resting inertial units of known noise, made without anything that estimates it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from shared.geometry import FloatArray
from station.model.frames import ImuBatch

UP = np.array([0.0, 0.0, 9.81])


@dataclass(frozen=True, slots=True)
class TrueNoise:
    """Of one sensor, the same on each axis. Units as in IEEE Std 952, SI."""

    density: float
    walk: float
    instability: float = 0.0


# Consumer units: plain ones, and such whose flicker hides the beginning of the random walk.
GYRO = TrueNoise(2.6e-4, 2e-5)
ACCEL = TrueNoise(2.26e-3, 3e-4)
FLICKERING_GYRO = TrueNoise(1.7e-4, 1.9e-5, 6e-5)
FLICKERING_ACCEL = TrueNoise(1.5e-3, 2e-4, 6e-4)
QUIET_GYRO = TrueNoise(7e-5, 4e-6)
QUIET_ACCEL = TrueNoise(8e-4, 5e-5)


def axis(rng: np.random.Generator, count: int, rate_hz: float, noise: TrueNoise) -> FloatArray:
    """Samples (count,) of one axis at rest, without bias."""
    white = noise.density * np.sqrt(rate_hz) * rng.standard_normal(count)
    walk = np.cumsum(noise.walk / np.sqrt(rate_hz) * rng.standard_normal(count))
    return white + walk + _flicker(rng, count, rate_hz, noise.instability)


def _flicker(rng: np.random.Generator, count: int, rate_hz: float, B: float) -> FloatArray:
    """Noise of density B^2 / (2 pi f): first-order processes whose time constants lie evenly on a log scale."""
    total = np.zeros(count)
    if B == 0.0:
        return total
    step = np.log(2.0)
    for rate in np.exp(np.arange(np.log(0.1 * rate_hz / count), np.log(3.0 * np.pi * rate_hz), step)):
        sigma = B * np.sqrt(step / np.pi)
        keep = np.exp(-rate / rate_hz)
        kicks = sigma * np.sqrt(1.0 - keep**2) * rng.standard_normal(count)
        kicks[0] = sigma * rng.standard_normal()
        total += lfilter([1.0], [1.0, -keep], kicks)
    return total


def resting(
    seed: int, duration_s: float, rate_hz: float = 200.0, gyro: TrueNoise = GYRO, accel: TrueNoise = ACCEL
) -> ImuBatch:
    """A level unit at rest, with constant biases."""
    rng = np.random.default_rng([seed, 20])
    count = int(duration_s * rate_hz)
    t_ns = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    omega = np.stack([axis(rng, count, rate_hz, gyro) for _ in range(3)], axis=1)
    force = np.stack([axis(rng, count, rate_hz, accel) for _ in range(3)], axis=1)
    return ImuBatch(t_ns, omega + 0.02 * rng.standard_normal(3), force + UP + 0.1 * rng.standard_normal(3))


FACES = np.vstack([np.eye(3), -np.eye(3)])
EDGES = np.array([(1, 1, 0), (-1, 1, 0), (1, 0, 1), (-1, 0, 1), (0, 1, 1), (0, -1, 1)]) / np.sqrt(2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """A unit that was laid on its different sides, and what its accelerometer really is."""

    imu: ImuBatch
    scale: FloatArray  # (3,) force = T @ (scale * (reading - bias))
    angles: FloatArray  # (3,) rad; above T's diagonal are -angles[0], angles[1], -angles[2]
    bias: FloatArray  # (3,) m/s^2, amid the rests


def turned(
    seed: int,
    directions: FloatArray,
    first_s: float = 90.0,
    rest_s: float = 10.0,
    rate_hz: float = 100.0,
    accel: TrueNoise = ACCEL,
) -> Turned:
    """First at rest for the noise, then on each side; up is some 5 degrees from `directions` (n, 3) of the sensor."""
    rng = np.random.default_rng([seed, 21])
    moving_s = 3.0
    lasting = np.array([first_s, *[rest_s] * (len(directions) - 1)])
    begin = np.cumsum(lasting + moving_s) - lasting
    count = int((begin[-1] + lasting[-1]) * rate_hz)
    t = np.arange(count) / rate_hz
    up = directions + rng.normal(0.0, np.radians(5.0), directions.shape)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    lies = np.searchsorted(begin, t, side="right") - 1  # -1 while it is carried there
    is_carried = (lies < 0) | (t > (begin + lasting)[lies])
    force = 9.81 * up[lies]
    force[is_carried] += rng.normal(0.0, 2.0, (int(is_carried.sum()), 3))
    omega = np.where(is_carried[:, None], rng.normal(0.0, 1.0, (count, 3)), 0.0)

    scale = 1.0 + rng.normal(0.0, 0.02, 3)
    yx, zx, zy = angles = rng.normal(0.0, 0.01, 3)
    T = np.array([[1.0, -yx, zx], [0.0, 1.0, -zy], [0.0, 0.0, 1.0]])
    drift = np.stack([axis(rng, count, rate_hz, TrueNoise(0.0, accel.walk)) for _ in range(3)], axis=1)
    white = np.stack([axis(rng, count, rate_hz, TrueNoise(accel.density, 0.0)) for _ in range(3)], axis=1)
    bias = rng.normal(0.0, 0.3, 3)
    reading = np.linalg.solve(T, force.T).T / scale + bias + drift + white
    omega += np.stack([axis(rng, count, rate_hz, GYRO) for _ in range(3)], axis=1) + 0.02 * rng.standard_normal(3)
    amid = int(np.median(begin + 0.5 * lasting) * rate_hz)
    t_ns = np.round(t * 1e9).astype(np.int64)
    return Turned(ImuBatch(t_ns, omega, reading), scale, angles, bias + drift[amid])
