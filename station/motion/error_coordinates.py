"""Small errors of a pose, velocity and points: three conventions, and what such an error does.

(R, X) is an element of SE_k(3) as in lie.py; its error is (phi, xi). The filter takes any of the conventions (thesis
eq. 2.7), least squares over windows takes the plain one.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from shared.geometry import FloatArray, skew, so3_log
from station.motion import lie


class ErrorKind(Enum):
    """How an error (phi, xi) moves the mean chi = (R, X)."""

    RIGHT = "right"  # chi = exp(xi) chi_mean: invariant, world frame (thesis eq. 2.7)
    LEFT = "left"  # chi = chi_mean exp(xi): invariant, body frame
    PLAIN = "plain"  # R = exp(phi) R_mean, everything else added: the conventional filter


def retract_group(
    kind: ErrorKind, R: FloatArray, X: FloatArray, phi: FloatArray, xi: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Move R (3, 3), X (k, 3) by errors phi (..., 3), xi (..., k, 3): thesis eq. 2.7 and its two variants."""
    E, Z = lie.exp(phi, xi)
    if kind is ErrorKind.RIGHT:
        return E @ R, X @ np.swapaxes(E, -1, -2) + Z
    if kind is ErrorKind.LEFT:
        return R @ E, Z @ np.swapaxes(R, -1, -2) + X
    return E @ R, X + xi


def difference_group(
    kind: ErrorKind, R_mean: FloatArray, X_mean: FloatArray, R: FloatArray, X: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The errors that retract_group needs to go from the mean to (R, X); inverse of retract_group."""
    R_mean_t = np.swapaxes(R_mean, -1, -2)
    if kind is ErrorKind.RIGHT:
        E = R @ R_mean_t
        return lie.log(E, X - X_mean @ np.swapaxes(E, -1, -2))
    if kind is ErrorKind.LEFT:
        return lie.log(R_mean_t @ R, (X - X_mean) @ R_mean)
    return so3_log(R @ R_mean_t), X - X_mean


def as_displacement(
    kind: ErrorKind, R: FloatArray, x: FloatArray, phi: FloatArray, xi: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Small errors phi, xi (3, k) of the pose (R, x) as rotation vector and displacement in the world, (3, k) each."""
    if kind is ErrorKind.LEFT:
        return R @ phi, R @ xi
    return phi, xi - skew(x) @ phi if kind is ErrorKind.RIGHT else xi


def from_displacement(
    kind: ErrorKind, R: FloatArray, x: FloatArray, turn: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The errors phi, xi (3, k) of the pose (R, x) that as_displacement makes this of; its inverse."""
    if kind is ErrorKind.LEFT:
        return R.T @ turn, R.T @ moved
    return turn, moved + skew(x) @ turn if kind is ErrorKind.RIGHT else moved


def pose_jacobian(kind: ErrorKind, R: FloatArray, x: FloatArray, p: FloatArray) -> FloatArray:
    """d p_body / d(phi, xi_x) (..., 3, 6): a point p (..., 3) held still in the world, seen from the body (R, x)."""
    Rt = np.swapaxes(R, -1, -2)
    out = np.empty((*Rt.shape[:-1], 6))
    if kind is ErrorKind.LEFT:  # R exp(phi), x + R xi: p_body = exp(-phi)(p_body - xi)
        out[..., :3] = skew((Rt @ (p - x)[..., None])[..., 0])
        out[..., 3:] = -np.eye(3)
    else:
        out[..., :3] = Rt @ skew(p if kind is ErrorKind.RIGHT else p - x)
        out[..., 3:] = -Rt
    return out
