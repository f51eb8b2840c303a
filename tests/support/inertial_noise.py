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
