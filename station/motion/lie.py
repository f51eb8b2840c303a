"""SO(3) and SE_k(3), batched over leading axes.

An element of SE_k(3) is kept as its parts R (..., 3, 3) and X (..., k, 3): the matrix of thesis eq. B.5 is
[[R, X^T], [0, I]]. For the filter, X stacks velocity, position and p landmarks, so k = 2 + p. Its Lie algebra is
phi (..., 3) and xi (..., k, 3).
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray

DIAGONAL = np.arange(3)
SMALL = 1e-4  # rad; below it the series with terms up to angle^4 are exact to double precision


def skew(v: FloatArray) -> FloatArray:
    """Cross-product matrices (..., 3, 3) of v (..., 3). Thesis eq. B.1."""
    S = np.zeros((*v.shape, 3))
    S[..., 0, 1], S[..., 0, 2] = -v[..., 2], v[..., 1]
    S[..., 1, 0], S[..., 1, 2] = v[..., 2], -v[..., 0]
    S[..., 2, 0], S[..., 2, 1] = -v[..., 1], v[..., 0]
    return S


def gammas(phi: FloatArray, orders: tuple[int, ...]) -> list[FloatArray]:
    """Gamma_m(phi) = sum_n [phi]x^n / (n + m)! for m of 0, 1, 2: the exponential and its m-fold integrals over time.

    Source: Bloesch et al., RSS 2012, appendix.
    """
    theta2 = np.einsum("...i,...i->...", phi, phi)
    theta = np.sqrt(theta2)
    near = theta < SMALL
    t = np.where(near, 1.0, theta)
    t2 = t * t
    sin, cos = np.sin(t), np.cos(t)
    S = skew(phi)
    SS = S @ S
    result = []
    for order in orders:
        if order == 0:
            a = np.where(near, 1.0 - theta2 / 6.0, sin / t)
            b = np.where(near, 0.5 - theta2 / 24.0, (1.0 - cos) / t2)
        elif order == 1:
            a = np.where(near, 0.5 - theta2 / 24.0, (1.0 - cos) / t2)
            b = np.where(near, 1.0 / 6.0 - theta2 / 120.0, (t - sin) / (t2 * t))
        else:
            a = np.where(near, 1.0 / 6.0 - theta2 / 120.0, (t - sin) / (t2 * t))
            # 0.5 t^2 + cos - 1 loses all digits below about 0.1 rad: series to t^4 there
            series = 1.0 / 24.0 - theta2 / 720.0 + theta2 * theta2 / 40320.0
            b = np.where(theta < 0.1, series, (0.5 * t2 + cos - 1.0) / (t2 * t2))
        gamma = a[..., None, None] * S + b[..., None, None] * SS
        gamma[..., DIAGONAL, DIAGONAL] += 0.5 if order == 2 else 1.0
        result.append(gamma)
    return result


def so3_exp(phi: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of rotation vectors (..., 3). Thesis eq. B.2."""
    return gammas(phi, (0,))[0]


def so3_left_jacobian(phi: FloatArray) -> FloatArray:
    """J (..., 3, 3) with exp(phi + d) = exp(J d) exp(phi) to first order. Barfoot, State Estimation, eq. 7.77."""
    return gammas(phi, (1,))[0]


def so3_log(R: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), length at most pi, of rotations (..., 3, 3). Thesis eq. B.4 away from pi."""
    vee = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1
    )
    sin = np.linalg.norm(vee, axis=-1)
    cos = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    theta = np.arctan2(sin, cos)
    factor = np.where(sin < 1e-8, 1.0 + theta * theta / 6.0, theta / np.where(sin < 1e-8, 1.0, sin))
    out = factor[..., None] * vee
    far = cos < -0.99
    if np.any(far):
        out = np.where(far[..., None], _log_near_pi(R, vee, theta), out)
    return out


def _log_near_pi(R: FloatArray, vee: FloatArray, theta: FloatArray) -> FloatArray:
    """Near pi the antisymmetric part vanishes: the axis comes from R + R^T = 2 cos I + 2 (1 - cos) a a^T."""
    symmetric = 0.5 * (R + np.swapaxes(R, -1, -2))
    cos = np.cos(theta)[..., None, None]
    outer = (symmetric - cos * np.eye(3)) / np.maximum(1.0 - cos, 0.5)
    column = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    axis = np.take_along_axis(outer, column[..., None, None], axis=-1)[..., 0]
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    sign = np.where(np.einsum("...i,...i->...", axis, vee) < 0.0, -1.0, 1.0)
    return (sign * theta)[..., None] * axis


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


def compose(R_a: FloatArray, X_a: FloatArray, R_b: FloatArray, X_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    return R_a @ R_b, X_b @ np.swapaxes(R_a, -1, -2) + X_a


def inverse(R: FloatArray, X: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.swapaxes(R, -1, -2), -(X @ R)
