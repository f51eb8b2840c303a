"""What a MEMS IMU makes of the true motion: noise, bias, bias walk, vibration, saturation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robot.simulation.body import MotionState
from robot.simulation.config import ImuImperfections
from shared.calibration import ImuNoise
from shared.geometry import FloatArray

REFERENCE_SPEED_M_S = 0.4  # vibration figures are given at this speed
SHAKEN_AXES = np.array([1.0, 1.0, 1.0, 0.7, 0.7, 1.3])  # of the figures, of gyroscope and accelerometer


@dataclass(frozen=True, slots=True, eq=False)
class ImuMeasurement:
    """One sample and the biases in it."""

    gyro_imu: FloatArray  # (3,) rad/s
    accel_imu: FloatArray  # (3,) m/s^2
    gyro_bias: FloatArray  # (3,)
    accel_bias: FloatArray  # (3,)


class ImuModel:
    """Turns motion into samples; one call per tick, in time order."""

    def __init__(self, noise: ImuNoise, imperfections: ImuImperfections, gravity: float, seed: int) -> None:
        self._imperfections = imperfections
        self._gravity = np.array([0.0, 0.0, gravity])
        self._rng = np.random.default_rng([seed, 12])
        bias = 1.0 if imperfections.bias else 0.0
        size = (imperfections.gyro_bias_rad_s, imperfections.accel_bias_m_s2)
        self._bias = np.concatenate([bias * of * self._rng.standard_normal(3) for of in size])
        self._vibration = np.zeros(6)
        # Of gyroscope and accelerometer, three axes each.
        root_rate = np.sqrt(noise.rate_hz)
        self._walk = np.repeat([noise.gyro_walk / root_rate, noise.accel_walk / root_rate], 3)
        self._white = np.repeat([noise.gyro_density * root_rate, noise.accel_density * root_rate], 3)
        self._shaking = np.repeat([imperfections.gyro_vibration_rad_s, imperfections.accel_vibration_m_s2], 3)
        self._range = np.repeat([noise.gyro_range, noise.accel_range], 3)

    def measure(self, motion: MotionState) -> ImuMeasurement:
        i = self._imperfections
        white = self._rng.standard_normal(18)  # always drawn, so that switches do not shift the random numbers
        sample = np.concatenate([motion.omega_body, motion.R_world_body.T @ (motion.a_world + self._gravity)])
        if i.bias_walk:
            self._bias = self._bias + self._walk * white[0:6]
        sample += self._bias
        if i.noise:
            sample += self._white * white[6:12]
        if i.vibration:
            self._vibrate(motion, white[12:18])
            sample += self._shaking * self._vibration * SHAKEN_AXES
        if i.saturation:
            sample = np.minimum(np.maximum(sample, -self._range), self._range)
        return ImuMeasurement(sample[:3], sample[3:], self._bias[:3], self._bias[3:])

    def _vibrate(self, motion: MotionState, white: FloatArray) -> None:
        """High-pass filtered noise that grows with the speed of the wheels: it shakes but does not drift."""
        speed = 0.0
        if motion.carried == 0.0 and not motion.is_waved:
            speed = float(np.hypot(*motion.v_world[:2]) + 0.15 * abs(motion.omega_body[2])) / REFERENCE_SPEED_M_S
        # Unit variance, lag-1 correlation -0.5: its sum, unlike white noise's, stays small.
        self._vibration = -0.5 * self._vibration + np.sqrt(0.75) * white * min(speed, 2.0)
