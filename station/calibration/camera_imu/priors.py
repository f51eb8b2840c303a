"""What is known of a calibration before anything is measured, with a target or without."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import CameraCalibration, ImuNoise
from shared.geometry import FloatArray, IntArray
from station.calibration.camera_imu.unknowns import BIAS_EVERY_S, BIASES, DELAY, GRAVITY, INTRINSICS, intrinsics_of

# Gravity differs by 0.026 m/s^2 from pole to equator, a consumer accelerometer's scale by half a percent.
SIGMA_GRAVITY = 0.05
SIGMA_FIRST_BIAS = np.repeat([0.2, 0.5], 3)  # rad/s, m/s^2: the MPU-6050's data sheet allows 0.35 and 0.8
SIGMA_DELAY_S = 1e-4  # rows are read within 50 ms at the slowest: keeps finite what no motion shows


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of some of the border, whitened: residual (m,), its derivative (m, c) by c columns."""

    columns: IntArray
    residual: FloatArray
    J: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """Of the camera, of gravity and of the IMU."""

    camera: CameraCalibration
    sigma_intrinsics: FloatArray  # (8,) of what is told; 0: kept
    gravity: float  # m/s^2
    noise: ImuNoise

    def priors(self, camera: CameraCalibration, gravity: FloatArray, biases: FloatArray) -> list[Prior]:
        """At an estimate: the size of gravity (3,), lens and line delay as told, biases (nodes, 6) that walk slowly."""
        size = float(np.linalg.norm(gravity))
        known = self.sigma_intrinsics > 0
        sigma = self.sigma_intrinsics[known]
        away = (intrinsics_of(camera) - intrinsics_of(self.camera))[known]
        found = [
            scalar_prior(columns_of(GRAVITY), size - self.gravity, gravity[None] / size, SIGMA_GRAVITY),
            Prior(columns_of(INTRINSICS)[known], away / sigma, np.diag(1.0 / sigma)),
            scalar_prior(np.array([DELAY]), camera.line_delay_s - self.camera.line_delay_s, np.eye(1), SIGMA_DELAY_S),
            Prior(BIASES + np.arange(6), biases[0] / SIGMA_FIRST_BIAS, np.diag(1.0 / SIGMA_FIRST_BIAS)),
        ]
        walk = np.repeat([self.noise.gyro_walk, self.noise.accel_walk], 3) * np.sqrt(BIAS_EVERY_S)
        J = np.hstack([-np.diag(1.0 / walk), np.diag(1.0 / walk)])
        for node, step in enumerate(np.diff(biases, axis=0)):
            found.append(Prior(BIASES + 6 * node + np.arange(12), step / walk, J))
        return found


def scalar_prior(columns: IntArray, away: float, J: FloatArray, sigma: float) -> Prior:
    return Prior(columns, np.array([away / sigma]), J / sigma)


def columns_of(which: slice) -> IntArray:
    return np.arange(which.start, which.stop)
