"""Odometry of a robot on wheels: the gyroscope for heading, the drive commands for distance.

Good to a few per cent of the way, whatever the camera sees. `DeadReckoning` follows a robot while it drives, between
images and where no SLAM runs; `reckon_drive` goes over a recorded navigation as a whole, of which bias and vertical are
known better. How far the wheels roll is said in drive_commands.py for both, and for the filter's coasting.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray, se3, so3_exp, upright
from station.model.frames import DriveSample, ImuBatch
from station.motion.drive_commands import CommandedRest, WheelSpeed, resting_samples, wheel_motion
from station.motion.inertial_track import InertialTrack

BIAS_TAU_S = 2.0
LEVEL_TAU_S = 4.0
SETTLE_S = 1.0  # after the first sample: gravity and bias are learnt faster
MIN_REST_S = 0.5  # less of a recorded navigation says nothing of the gyroscope's bias


def advance_on_floor(
    x_world: FloatArray, yaw_rad: float, turned_rad: float, rolled_m: float
) -> tuple[FloatArray, float]:
    """Position (3,) and yaw after rolling forward while turning evenly on a level floor."""
    middle = yaw_rad + 0.5 * turned_rad
    return x_world + rolled_m * np.array([np.cos(middle), np.sin(middle), 0.0]), yaw_rad + turned_rad


class DeadReckoning:
    """Feed IMU and drive samples in time order; `T_nav_body` is the pose so far (z up, starts at the origin)."""

    def __init__(self) -> None:
        self.t_robot_ns: int | None = None
        self._start_ns = 0
        self._yaw = 0.0
        self._position = np.zeros(3)
        self._up: FloatArray | None = None
        self._bias = np.zeros(3)
        self._wheels = WheelSpeed()
        self._way_m = 0.0  # of the wheels, at the last step
        self._rest = CommandedRest()

    @property
    def T_nav_body(self) -> FloatArray:
        """(4, 4) metres."""
        return se3(so3_exp(np.array([0.0, 0.0, self._yaw])), self._position.copy())

    def add_drive(self, drive: DriveSample) -> None:
        self._wheels.add_drive(drive)
        self._rest.add_drive(drive)

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
            self._wheels.advance(t)
            self._way_m = self._wheels.way_m
            return
        seconds = (t - self.t_robot_ns) / 1e9
        self.t_robot_ns = t
        if seconds <= 0:
            return
        settling = t - self._start_ns < SETTLE_S * 1e9
        self._up = self._up + (1 - float(np.exp(-seconds / LEVEL_TAU_S))) * (accel - self._up)
        if self._rest.is_resting(t) and float(np.linalg.norm(gyro - self._bias)) < (0.2 if settling else 0.05):
            share = 1 - float(np.exp(-seconds / (0.3 if settling else BIAS_TAU_S)))
            self._bias = self._bias + share * (gyro - self._bias)
            rate = 0.0
        else:
            up = self._up / max(float(np.linalg.norm(self._up)), 1e-9)
            rate = float(up @ (gyro - self._bias))
        self._wheels.advance(t)
        rolled_m, self._way_m = self._wheels.way_m - self._way_m, self._wheels.way_m
        self._position, self._yaw = advance_on_floor(self._position, self._yaw, rate * seconds, rolled_m)


def reckon_drive(
    imu: ImuBatch, drive: list[DriveSample], t_ns: IntArray, gyro_bias: FloatArray | None = None
) -> tuple[FloatArray, InertialTrack]:
    """Where gyroscope and drive commands say the body was in a recorded navigation.

    Args:
        t_ns: (N,) times on the IMU's clock, within its samples.
        gyro_bias: (3,) rad/s; None: from the time at rest, else zero.
    Returns:
        T_world_body (N, 4, 4), z up, the first at the origin; and the integrated samples.
    """
    if gyro_bias is None:
        gyro_bias = bias_at_rest(imu, drive)
    track = InertialTrack(imu, np.zeros(3) if gyro_bias is None else gyro_bias)
    R_world_start = level(imu, track, drive)
    speed, _ = wheel_motion(drive, imu.t_robot_ns)
    velocity = (R_world_start @ track.R)[:, :, 0] * speed[:, None]
    dt = np.diff(imu.t_robot_ns)[:, None] * 1e-9
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt, axis=0)])
    seconds = (imu.t_robot_ns - imu.t_robot_ns[0]) * 1e-9
    at = (t_ns - imu.t_robot_ns[0]) * 1e-9
    p_world = np.column_stack([np.interp(at, seconds, way[:, i]) for i in range(3)])
    p_world -= p_world[0]
    R_world = R_world_start @ track.rotation_at(t_ns)
    return np.stack([se3(R, t) for R, t in zip(R_world, p_world, strict=True)]), track


def bias_at_rest(imu: ImuBatch, drive: list[DriveSample]) -> FloatArray | None:
    """Gyroscope bias (3,) rad/s from the time the robot stood still; None where that is too short."""
    rest = resting_samples(imu, drive)
    if rest.sum() < 2:
        return None
    period = float(np.median(np.diff(imu.t_robot_ns))) * 1e-9
    if rest.sum() * period < MIN_REST_S:
        return None
    return np.asarray(np.median(imu.gyro_imu[rest], axis=0))


def level(imu: ImuBatch, track: InertialTrack, drive: list[DriveSample]) -> FloatArray:
    """R_world_start (3, 3): z up at the first sample, x axis of the body at yaw 0."""
    rest = resting_samples(imu, drive)
    use = rest if rest.sum() > 50 else np.ones(len(imu), dtype=bool)  # a whole navigation's mean: accelerations cancel
    up = np.einsum("nij,nj->i", track.R[use], imu.accel_imu[use])
    return upright(up, np.eye(3))
