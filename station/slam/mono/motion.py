"""The camera moves smoothly: constant velocity and angular velocity, pushed by unknown impulses (thesis 2.1 to 2.3).

The camera's state x_v (13,) is r^W (0:3), q^WR (3:7) wxyz, v^W (7:10), omega^R (10:13): position, attitude and velocity
in the world W, angular velocity in the camera's own axes R (x right, y down, z along the view).
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.slam.mono.config import FilterConfig
from station.slam.mono.quaternion import from_rotation_vector, left, right

POSITION, ATTITUDE, VELOCITY, TURN = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
CAMERA = 13  # size of the camera's part of the state
POSE = 7  # position and attitude: all that an image depends on


def first_camera(config: FilterConfig) -> tuple[FloatArray, FloatArray]:
    """State (13,) and covariance (13, 13) at the first image, whose pose is the world: known, by definition."""
    x = np.zeros(CAMERA)
    x[3] = 1.0
    P = np.zeros((CAMERA, CAMERA))
    P[VELOCITY, VELOCITY] = config.sigma_first_velocity**2 * np.eye(3)
    P[TURN, TURN] = config.sigma_first_turn**2 * np.eye(3)
    return x, P


def move(x_v: FloatArray, impulse: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """f_v of eq. 2.2 after dt, with its derivatives.

    Args:
        x_v: (13,) the camera's state.
        impulse: (6,) n of eq. 2.1: V^W (units/s) and Omega^R (rad/s).
    Returns:
        The new state (13,), its derivative by x_v (13, 13) and by n (13, 6).
    """
    v, omega = x_v[VELOCITY] + impulse[:3], x_v[TURN] + impulse[3:]
    turned, turned_by_phi = from_rotation_vector(omega * dt_s)
    new = np.concatenate([x_v[POSITION] + v * dt_s, right(turned) @ x_v[ATTITUDE], v, omega])  # eq. 2.2

    by_omega = left(x_v[ATTITUDE]) @ turned_by_phi * dt_s
    F = np.eye(CAMERA)
    F[POSITION, VELOCITY] = dt_s * np.eye(3)
    F[ATTITUDE, ATTITUDE] = right(turned)
    F[ATTITUDE, TURN] = by_omega
    G = np.zeros((CAMERA, 6))
    G[POSITION, :3] = dt_s * np.eye(3)
    G[ATTITUDE, 3:] = by_omega
    G[VELOCITY, :3] = G[TURN, 3:] = np.eye(3)
    return new, F, G


def impulse_covariance(config: FilterConfig, dt_s: float) -> FloatArray:
    """P_n (6, 6) of eq. 2.3: of the impulses a^W dt and alpha^R dt of eq. 2.1, diagonal."""
    sigma = np.repeat([config.sigma_accel, config.sigma_angular_accel], 3) * dt_s
    return np.diag(sigma**2)
