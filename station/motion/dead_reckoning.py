"""Odometry from what every robot has: the gyro for heading, the drive commands for distance.

Used between images while no SLAM runs online. On a skid-steer robot commands say nothing about turning (a third of
the commanded rate is achieved), but the gyro does; distance is good to some five percent.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, se3, so3_exp
from station.model.frames import DriveSample, ImuBatch

BIAS_TAU_S = 2.0
LEVEL_TAU_S = 4.0
COMMAND_HOLD_S = 0.5  # a command without successor counts this long (its time to live)
REST_AFTER_S = 0.7  # until the body rests after the last moving command
SETTLE_S = 1.0


class DeadReckoning:
    """Feed IMU and drive samples in time order; `T_nav_body` is the pose so far (z up, starts at the origin)."""

    def __init__(self) -> None:
        self.t_robot_ns: int | None = None
        self._start_ns = 0
        self._yaw = 0.0
        self._position = np.zeros(3)
        self._up: FloatArray | None = None
        self._bias = np.zeros(3)
        self._speed = 0.0
        self._speed_until_ns = 0
        self._rest_from_ns = 0

    @property
    def T_nav_body(self) -> FloatArray:
        """(4, 4) metres."""
        return se3(so3_exp(np.array([0.0, 0.0, self._yaw])), self._position.copy())

    def add_drive(self, drive: DriveSample) -> None:
        self._speed = drive.linear_m_s
        self._speed_until_ns = drive.t_robot_ns + round(COMMAND_HOLD_S * 1e9)
        if abs(drive.linear_m_s) > 1e-3 or abs(drive.angular_rad_s) > 1e-3:
            self._rest_from_ns = self._speed_until_ns + round(REST_AFTER_S * 1e9)
        else:
            self._rest_from_ns = min(self._rest_from_ns, drive.t_robot_ns + round(REST_AFTER_S * 1e9))

    def add_imu(self, imu: ImuBatch) -> None:
        """Integrate a batch; averaging over it is fine at some 20 samples a batch."""
        for start in range(0, len(imu), 10):
            part = slice(start, start + 10)
            gyro, accel = imu.gyro_imu[part].mean(axis=0), imu.accel_imu[part].mean(axis=0)
            self._step(int(imu.t_robot_ns[part][-1]), gyro, accel)

    def _step(self, t: int, gyro: FloatArray, accel: FloatArray) -> None:
        if self.t_robot_ns is None or self._up is None:
            self.t_robot_ns = self._start_ns = t
            self._up = accel.copy()
            self._bias = gyro.copy() if float(np.linalg.norm(gyro)) < 0.2 else np.zeros(3)
            return
        seconds = (t - self.t_robot_ns) / 1e9
        self.t_robot_ns = t
        if seconds <= 0:
            return
        settling = t - self._start_ns < SETTLE_S * 1e9
        self._up = self._up + (1 - float(np.exp(-seconds / LEVEL_TAU_S))) * (accel - self._up)
        if t > self._rest_from_ns and float(np.linalg.norm(gyro - self._bias)) < (0.2 if settling else 0.05):
            share = 1 - float(np.exp(-seconds / (0.3 if settling else BIAS_TAU_S)))
            self._bias = self._bias + share * (gyro - self._bias)
            rate = 0.0
        else:
            up = self._up / max(float(np.linalg.norm(self._up)), 1e-9)
            rate = float(up @ (gyro - self._bias))
        speed = self._speed if t < self._speed_until_ns else 0.0
        heading = self._yaw + 0.5 * rate * seconds
        self._yaw += rate * seconds
        self._position = self._position + speed * seconds * np.array([np.cos(heading), np.sin(heading), 0.0])
