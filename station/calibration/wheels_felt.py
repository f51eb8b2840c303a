"""How far a robot went by its accelerometer: a metre that neither board nor focal length touches."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from shared.geometry import FloatArray, cross
from station.model.frames import ImuBatch


def felt_way(imu: ImuBatch, rest: tuple[int, int], begin_ns: int, end_ns: int) -> float:
    """The way forward (m, IMU's x axis) of a straight move that begins and ends at rest.

    Standing at both ends takes away what is constant, bias and a tilt of the floor alike; the gyroscope tells by how
    much the robot nodded meanwhile. White noise of density N leaves N sqrt(T^3 / 12) after T seconds.

    Args:
        rest: begin and end (ns) of the rest before the move.
    """
    still = slice(*np.searchsorted(imu.t_robot_ns, rest))
    part = slice(*np.searchsorted(imu.t_robot_ns, (begin_ns, end_ns)))
    t_s = np.asarray((imu.t_robot_ns[part] - begin_ns) * 1e-9, dtype=np.float64)
    turned = _integrals(imu.gyro_imu[part] - imu.gyro_imu[still].mean(axis=0), t_s)
    up = imu.accel_imu[still].mean(axis=0)  # m/s^2: what holds the robot against gravity
    forward = (imu.accel_imu[part] + cross(turned, np.broadcast_to(up, turned.shape)))[:, 0]
    forward -= np.trapezoid(forward, t_s) / np.ptp(t_s)
    return float(np.trapezoid(_integrals(forward, t_s), t_s))


def _integrals(values: FloatArray, t_s: FloatArray) -> FloatArray:
    """(N, ...) from the first time to each."""
    return np.asarray(cumulative_trapezoid(values, t_s, axis=0, initial=0.0))
