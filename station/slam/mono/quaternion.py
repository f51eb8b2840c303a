"""Unit quaternions wxyz (..., 4) with the derivatives that the filter needs.

`rotate` is written for quaternions of any length (it scales by the length squared), so that its derivative is exact.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, skew

CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
TINY_RAD = 1e-6  # below, the sine is its argument to double precision


def rotate(q: FloatArray, a: FloatArray) -> FloatArray:
    """R(q) a for a (..., 3): (w^2 - |v|^2) a + 2 v (v.a) + 2 w v x a."""
    w, v = q[..., :1], q[..., 1:]
    dot = (v * a).sum(axis=-1, keepdims=True)
    return (w * w - (v * v).sum(axis=-1, keepdims=True)) * a + 2.0 * v * dot + 2.0 * w * np.cross(v, a)


def rotate_by_q(q: FloatArray, a: FloatArray) -> FloatArray:
    """Derivative (..., 3, 4) of `rotate` by q."""
    w, v = q[..., :1], np.broadcast_to(q[..., 1:], a.shape)
    J = np.empty((*a.shape, 4))
    J[..., 0] = 2.0 * (w * a + np.cross(v, a))
    dot = (v * a).sum(axis=-1)
    J[..., 1:] = v[..., :, None] * a[..., None, :] - a[..., :, None] * v[..., None, :] - w[..., None] * skew(a)
    J[..., range(3), range(1, 4)] += dot[..., None]
    J[..., 1:] *= 2.0
    return J


def rotation(q: FloatArray) -> FloatArray:
    """R(q) (..., 3, 3) of unit quaternions (..., 4)."""
    return np.swapaxes(rotate(q[..., None, :], np.eye(3)), -1, -2)


def left(q: FloatArray) -> FloatArray:
    """(4, 4) with left(q) @ p = q x p, of q (4,)."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


def right(q: FloatArray) -> FloatArray:
    """(4, 4) with right(q) @ p = p x q, of q (4,)."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


def from_rotation_vector(phi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The quaternion (4,) of an angle-axis vector phi (3,) rad, and its derivative by phi (4, 3)."""
    angle = float(np.linalg.norm(phi))
    J = np.empty((4, 3))
    if angle < TINY_RAD:
        J[0], J[1:] = -0.25 * phi, 0.5 * np.eye(3)
        return np.concatenate([[1.0], 0.5 * phi]), J
    axis, half = phi / angle, 0.5 * angle
    sine, cosine = np.sin(half), np.cos(half)
    J[0] = -0.5 * sine * axis
    J[1:] = sine / angle * np.eye(3) + (0.5 * cosine - sine / angle) * np.outer(axis, axis)
    return np.concatenate([[cosine], sine * axis]), J


def normalise(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The unit quaternion (4,) along q (4,), and its derivative by q (4, 4)."""
    length = float(np.linalg.norm(q))
    unit = q / length
    return unit, (np.eye(4) - np.outer(unit, unit)) / length
