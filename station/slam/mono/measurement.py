"""Where the camera should see a feature, and how that changes with the state (thesis 2.4 to 2.6, C.1 to C.5).

A feature is a row y (6,): x_i, y_i, z_i, theta_i, phi_i, rho_i with inverse depth (C.2), or X, Y, Z and three zeros
(C.1). The camera's axes here are x right, y down, z along the view, as everywhere in this project. The thesis prints
eq. 2.5 for axes turned by half a turn about the view, hence its minus signs; and C.5 with a bracket too early: r^WC is
scaled by rho as well, else a far point would not stay where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, homogeneous
from station.slam.mono.motion import ATTITUDE, CAMERA, POSE, POSITION
from station.slam.mono.quaternion import CONJUGATE, rotate, rotate_by_q, rotation
from station.vision.lens import BoolArray, Lens

MIN_COSINE = 0.3  # to the optical axis: beyond 72 degrees no lens here sees


def bearing(theta_phi: FloatArray) -> FloatArray:
    """m(theta, phi) (..., 3) of azimuth and elevation (..., 2) rad. Eq. C.4."""
    theta, phi = theta_phi[..., 0], theta_phi[..., 1]
    return np.stack([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1)


def bearing_by_angles(theta_phi: FloatArray) -> FloatArray:
    """Derivative (..., 3, 2) of eq. C.4."""
    sin_t, sin_p = np.sin(theta_phi[..., 0]), np.sin(theta_phi[..., 1])
    cos_t, cos_p = np.cos(theta_phi[..., 0]), np.cos(theta_phi[..., 1])
    by_theta = np.stack([cos_p * cos_t, np.zeros_like(cos_p), -cos_p * sin_t], axis=-1)
    by_phi = np.stack([-sin_p * sin_t, -cos_p, -sin_p * cos_t], axis=-1)
    return np.stack([by_theta, by_phi], axis=-1)


def angles_of(ray: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation (N, 2) of rays (N, 3), the inverse of eq. C.4, and the derivative (N, 2, 3)."""
    x, y, z = ray[:, 0], ray[:, 1], ray[:, 2]
    level2 = x * x + z * z
    level = np.sqrt(level2)
    whole2 = level2 + y * y
    J = np.zeros((len(ray), 2, 3))
    J[:, 0, 0], J[:, 0, 2] = z / level2, -x / level2
    J[:, 1, 0], J[:, 1, 1], J[:, 1, 2] = x * y / (whole2 * level), -level / whole2, z * y / (whole2 * level)
    return np.stack([np.arctan2(x, z), np.arctan2(-y, level)], axis=1), J


def first_seen(
    x_v: FloatArray, uv_px: FloatArray, rho: FloatArray, lens: Lens
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Features y (N, 6) of eq. C.2 from one view of them: pixels (N, 2), inverse depths (N,), cameras (N, 13).

    With the derivatives by the camera (N, 6, 13), and by pixel and inverse depth (N, 6, 3).
    """
    q, h_R = x_v[:, ATTITUDE], homogeneous(lens.unproject(uv_px))
    angles, by_ray = angles_of(rotate(q, h_R))
    by_camera, by_own = np.zeros((len(rho), 6, CAMERA)), np.zeros((len(rho), 6, 3))
    by_camera[:, range(3), range(3)] = 1.0
    by_camera[:, 3:5, ATTITUDE] = by_ray @ rotate_by_q(q, h_R)
    by_own[:, 3:5, :2] = by_ray @ rotation(q)[:, :, :2] @ np.linalg.inv(lens.whitening(h_R[:, :2], 1.0))
    by_own[:, 5, 2] = 1.0
    return np.concatenate([x_v[:, POSITION], angles, rho[:, None]], axis=1), by_camera, by_own


def to_xyz(y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The points (N, 3) of inverse-depth features (N, 6), eq. C.3, and the derivative (N, 3, 6)."""
    m, rho = bearing(y[:, 3:5]), y[:, 5:]
    J = np.zeros((len(y), 3, 6))
    J[:, range(3), range(3)] = 1.0
    J[:, :, 3:5] = bearing_by_angles(y[:, 3:5]) / rho[:, :, None]
    J[:, :, 5] = -m / rho**2
    return y[:, :3] + m / rho, J


def direction(r: FloatArray, y: FloatArray, is_inverse: BoolArray) -> FloatArray:
    """From the camera at r (..., 3) to features (..., 6), in the world; of length rho d for inverse depth."""
    away = y[..., :3] - r
    inverse = y[..., 5:] * away + bearing(y[..., 3:5])  # bracket of eq. C.5
    return np.where(is_inverse[..., None], inverse, away)  # bracket of eq. 2.4


def project(
    r: FloatArray, q: FloatArray, y: FloatArray, is_inverse: BoolArray, lens: Lens
) -> tuple[FloatArray, BoolArray]:
    """Pixels (..., 2) of features, and which lie before the camera (...)."""
    h = rotate(q * CONJUGATE, direction(r, y, is_inverse))  # eqs. 2.4 and C.5: h^R = R^RW [...]
    in_front = h[..., 2] > MIN_COSINE * np.sqrt((h * h).sum(axis=-1))
    xy = h[..., :2] / np.where(in_front, h[..., 2], 1.0)[..., None]
    return lens.project(np.where(in_front[..., None], xy, 0.0)), in_front  # eq. 2.5, and the lens' distortion


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """What the state says of N features in the image."""

    uv_px: FloatArray  # (N, 2)
    in_view: BoolArray  # (N,)
    by_pose: FloatArray  # (N, 2, 7) derivative by r and q
    by_feature: FloatArray  # (N, 2, 6); the last three are zero for XYZ
    by_ray: FloatArray  # (N, 2, 3) derivative by the direction in the world
    extra: FloatArray  # (N, 2, 2) px^2 of variance that derivatives miss, see State.with_product_moments

    def of(self, rows: IntArray | BoolArray) -> Predicted:
        return Predicted(
            self.uv_px[rows],
            self.in_view[rows],
            self.by_pose[rows],
            self.by_feature[rows],
            self.by_ray[rows],
            self.extra[rows],
        )


def predict(x_v: FloatArray, y: FloatArray, is_inverse: BoolArray, lens: Lens, margin_px: float = 0.0) -> Predicted:
    """Pixels of features y (N, 6) seen with the camera's state x_v, with derivatives.

    in_view: at least margin_px inside of the image.
    """
    r, q = x_v[..., POSITION], x_v[..., ATTITUDE]
    uv, in_front = project(r, q, y, is_inverse, lens)
    a = direction(r, y, is_inverse)
    h = np.where(in_front[:, None], rotate(q * CONJUGATE, a), [0.0, 0.0, 1.0])
    z = h[:, 2]
    xy = h[:, :2] / z[:, None]
    pinhole = np.zeros((len(y), 2, 3))  # d xy / d h, eq. 2.5
    pinhole[:, 0, 0] = pinhole[:, 1, 1] = 1.0 / z
    pinhole[:, :, 2] = -xy / z[:, None]
    by_h = lens.whitening(xy, 1.0) @ pinhole

    R_RW = np.swapaxes(rotation(q), -1, -2)
    scale = np.where(is_inverse, y[:, 5], 1.0)[:, None, None]
    by_world = by_h @ R_RW
    by_pose = np.empty((len(y), 2, POSE))
    by_pose[:, :, POSITION] = -scale * by_world
    by_pose[:, :, ATTITUDE] = by_h @ (rotate_by_q(q * CONJUGATE, a) * CONJUGATE)
    by_feature = np.zeros((len(y), 2, 6))
    by_feature[:, :, :3] = scale * by_world
    i = is_inverse
    by_feature[i, :, 3:5] = by_world[i] @ bearing_by_angles(y[i, 3:5])
    by_feature[i, :, 5] = (by_world[i] @ np.broadcast_to(y[:, :3] - r, y[:, :3].shape)[i][:, :, None])[:, :, 0]
    return Predicted(
        uv, in_front & lens.is_inside(uv, margin_px), by_pose, by_feature, by_world, np.zeros((len(y), 2, 2))
    )
