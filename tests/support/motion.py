"""Inertial samples of what hands do to a robot."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.model.frames import ImuBatch

RATE = 225.0


SECOND = 1_000_000_000


def imu(gyro: FloatArray, accel: FloatArray, start_s: float = 0.0, seed: int = 0) -> list[ImuBatch]:
    """Batches of ten samples with the noise of driving; gyro (N, 3) and accel (N, 3) without gravity."""
    rng = np.random.default_rng(seed)
    n = len(gyro)
    t = ((start_s + np.arange(n) / RATE) * SECOND).astype(np.int64)
    g = gyro + 0.01 + rng.normal(0, 0.012, (n, 3))
    a = accel + np.array([0.1, -0.05, 9.81 + 0.1]) + rng.normal(0, 0.3, (n, 3))
    return [ImuBatch(t[k : k + 10], g[k : k + 10], a[k : k + 10]) for k in range(0, n, 10)]


def seconds(s: float) -> FloatArray:
    return np.zeros((int(s * RATE), 3))


def lift() -> FloatArray:
    """0.4 m up within 0.8 s: a sine of acceleration."""
    f = np.linspace(0, 1, int(0.8 * RATE))
    out = np.zeros((len(f), 3))
    out[:, 2] = 0.4 * 2 * np.pi / 0.8**2 * np.sin(2 * np.pi * f)
    return out
