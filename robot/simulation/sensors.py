"""What a MEMS IMU makes of the true motion: noise, bias, bias walk, vibration, saturation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robot.simulation.body import MotionState
from robot.simulation.config import ImuImperfections
from shared.calibration import ImuNoise
from shared.geometry import FloatArray

REFERENCE_SPEED_M_S = 0.4  # vibration figures are given at this speed


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
        self._noise, self._imperfections = noise, imperfections
        self._gravity = np.array([0.0, 0.0, gravity])
        self._rng = np.random.default_rng([seed, 12])
        bias = 1.0 if imperfections.bias else 0.0
        self._gyro_bias = bias * imperfections.gyro_bias_rad_s * self._rng.standard_normal(3)
        self._accel_bias = bias * imperfections.accel_bias_m_s2 * self._rng.standard_normal(3)
        self._vibration = np.zeros(6)

    def measure(self, motion: MotionState) -> ImuMeasurement:
        i, n, rng = self._imperfections, self._noise, self._rng
        gyro = motion.omega_body.copy()
        accel = motion.R_world_body.T @ (motion.a_world + self._gravity)
        white = rng.standard_normal(18)  # always drawn, so that switches do not shift the random numbers
        root_rate = np.sqrt(n.rate_hz)
        if i.bias_walk:
            self._gyro_bias = self._gyro_bias + n.gyro_walk / root_rate * white[0:3]
            self._accel_bias = self._accel_bias + n.accel_walk / root_rate * white[3:6]
        gyro += self._gyro_bias
        accel += self._accel_bias
        if i.noise:
            gyro += n.gyro_density * root_rate * white[6:9]
            accel += n.accel_density * root_rate * white[9:12]
        if i.vibration:
            self._vibrate(motion, white[12:18])
            gyro += i.gyro_vibration_rad_s * self._vibration[:3]
            accel += i.accel_vibration_m_s2 * self._vibration[3:] * np.array([0.7, 0.7, 1.3])
        if i.saturation:
            gyro = np.clip(gyro, -n.gyro_range, n.gyro_range)
            accel = np.clip(accel, -n.accel_range, n.accel_range)
        return ImuMeasurement(gyro, accel, self._gyro_bias, self._accel_bias)

    def _vibrate(self, motion: MotionState, white: FloatArray) -> None:
        """High-pass filtered noise that grows with the speed of the wheels: it shakes but does not drift."""
        speed = 0.0
        if motion.carried == 0.0 and not motion.is_waved:
            speed = float(np.hypot(*motion.v_world[:2]) + 0.15 * abs(motion.omega_body[2])) / REFERENCE_SPEED_M_S
        # Unit variance, lag-1 correlation -0.5: its sum, unlike white noise's, stays small.
        self._vibration = -0.5 * self._vibration + np.sqrt(0.75) * white * min(speed, 2.0)
