"""SE_k(3), and what shared/geometry.py leaves out of SO(3), batched over leading axes.

An element of SE_k(3) is kept as its parts R (..., 3, 3) and X (..., k, 3): the matrix of thesis eq. B.5 is
[[R, X^T], [0, I]]. For the filter, X stacks velocity, position and p landmarks, so k = 2 + p. Its Lie algebra is
phi (..., 3) and xi (..., k, 3).
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, gammas, skew, so3_log


def so3_left_jacobian(phi: FloatArray) -> FloatArray:
    """J (..., 3, 3) with exp(phi + d) = exp(J d) exp(phi) to first order. Barfoot, State Estimation, eq. 7.77."""
    return gammas(phi, (1,))[0]


def so3_left_jacobian_inverse(phi: FloatArray) -> FloatArray:
    """Inverse (..., 3, 3) of so3_left_jacobian."""
    theta2 = np.einsum("...i,...i->...", phi, phi)
    theta = np.sqrt(theta2)
    near = theta < 1e-2  # the closed form cancels: series with error below theta^6 / 1e6
    t = np.where(near, 1.0, theta)
    closed = (1.0 - 0.5 * t * np.cos(0.5 * t) / np.maximum(np.sin(0.5 * t), 1e-12)) / (t * t)
    b = np.where(near, 1.0 / 12.0 + theta2 / 720.0 + theta2 * theta2 / 30240.0, closed)
    S = skew(phi)
    return np.eye(3) - 0.5 * S + b[..., None, None] * (S @ S)


def exp(phi: FloatArray, xi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Group element (R, X) of the algebra element phi (..., 3), xi (..., k, 3)."""
    R, J = gammas(phi, (0, 1))
    return R, xi @ np.swapaxes(J, -1, -2)


def log(R: FloatArray, X: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Algebra element (phi, xi) of the group element (R, X)."""
    phi = so3_log(R)
    return phi, X @ np.swapaxes(so3_left_jacobian_inverse(phi), -1, -2)
