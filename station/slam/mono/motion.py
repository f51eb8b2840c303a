"""The camera moves smoothly: constant velocity and angular velocity, pushed by unknown impulses (thesis 2.1 to 2.3).

The camera's state x_v is r^W, q^WR, v^W, omega^R: position, attitude and velocity in the world W, angular velocity in
the camera's own axes R (x right, y down, z along the view). For the four numbers of q stand the matrix R^WR and the
small turn, in axes R, by which it may be off: three numbers, zero but in differences and covariances.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, gammas
from station.slam.mono.config import MonoConfig

POSITION, ATTITUDE, VELOCITY, TURN = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
CAMERA = 12  # size of the camera's part of the state
POSE = 6  # position and attitude: all that an image depends on


def move(
    x_v: FloatArray, R: FloatArray, impulse: FloatArray, dt_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """f_v of eq. 2.2: the camera's x_v (12,) and R (3, 3) after dt; its derivatives by x_v (12, 12) and by n (12, 6).

    impulse: (6,) n of eq. 2.1: V^W (units/s) and Omega^R (rad/s).
    """
    new = x_v.copy()
    new[VELOCITY] += impulse[:3]
    new[TURN] += impulse[3:]
    new[POSITION] += new[VELOCITY] * dt_s
    phi = new[TURN] * dt_s
    turned, by_turn = gammas(phi, (0, 1))  # q((omega^R + Omega^R) dt) of eq. 2.2, and how it changes

    F = np.eye(CAMERA)
    F[POSITION, VELOCITY] = dt_s * np.eye(3)
    F[ATTITUDE, ATTITUDE] = turned.T
    F[ATTITUDE, TURN] = by_turn.T * dt_s
    G = F[:, VELOCITY.start :]  # impulses act as the velocities do to which they are added
    return new, R @ turned, F, G


def impulse_covariance(config: MonoConfig, dt_s: float) -> FloatArray:
    """P_n (6, 6) of eq. 2.3: of eq. 2.1's impulses a^W dt and alpha^R dt (the thesis prints alpha^W), diagonal."""
    return np.diag((np.repeat([config.sigma_accel, config.sigma_angular_accel], 3) * dt_s) ** 2)
