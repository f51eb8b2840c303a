"""Where the camera should see a feature, and how that changes with the state (thesis 2.4, 2.5, C.1 to C.5).

A feature is a row y (6,): x_i, y_i, z_i, theta_i, phi_i, rho_i with inverse depth (C.2), or X, Y, Z and three zeros
(C.1). The camera's axes are x right, y down, z along the view. The thesis prints eq. 2.5 for axes turned by half a turn
about the view, hence its minus signs. Its C.5 has two brackets in other places; here it is R^CW (rho (x_i - r^WC) + m):
a point infinitely far away (rho = 0) does not move with the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, homogeneous, skew
from station.slam.mono.motion import ATTITUDE, POSE, POSITION
from station.vision.bearings import angles_of, bearing, bearing_by_angles
from station.vision.lens import BoolArray, Lens

MIN_COSINE = 0.3  # to the optical axis: beyond 72 degrees no lens here sees


def first_seen(
    r: FloatArray, R: FloatArray, uv_px: FloatArray, rho: float, lens: Lens
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Features y (N, 6) of eq. C.2 from one view of them; derivatives by pose (N, 6, 6), by pixel and rho (N, 6, 3)."""
    h = homogeneous(lens.unproject(uv_px))
    angles, by_ray = angles_of(h @ R.T)
    y = np.column_stack([np.tile(r, (len(h), 1)), angles, np.full(len(h), rho)])
    by_pose, by_own = np.zeros((len(h), 6, POSE)), np.zeros((len(h), 6, 3))
    by_pose[:, :3, POSITION] = np.eye(3)
    by_pose[:, 3:5, ATTITUDE] = by_ray @ -(R @ skew(h))
    by_own[:, 3:5, :2] = by_ray @ R[:, :2] @ np.linalg.inv(lens.whitening(h[:, :2], 1.0))
    by_own[:, 5, 2] = 1.0
    return y, by_pose, by_own


def to_xyz(y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The points (N, 3) of inverse-depth features (N, 6), eq. C.3, and the derivative (N, 3, 6)."""
    m, rho = bearing(y[:, 3:5]), y[:, 5:]
    by_angles = bearing_by_angles(y[:, 3:5]) / rho[:, :, None]
    by_origin = np.broadcast_to(np.eye(3), (len(y), 3, 3))
    return y[:, :3] + m / rho, np.concatenate([by_origin, by_angles, -(m / rho**2)[:, :, None]], axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """What the state says of N features in the image."""

    uv_px: FloatArray  # (N, 2)
    is_ahead: BoolArray  # (N,) of the camera; elsewhere the other fields mean nothing
    by_pose: FloatArray  # (N, 2, 6) derivative by the camera's pose
    by_feature: FloatArray  # (N, 2, 6); the last three are zero for XYZ

    def of(self, some: slice | IntArray) -> Predicted:
        return Predicted(self.uv_px[some], self.is_ahead[some], self.by_pose[some], self.by_feature[some])


def predict(r: FloatArray, R: FloatArray, y: FloatArray, is_inverse: BoolArray, lens: Lens) -> Predicted:
    """Pixels of features y (N, 6) seen from r (3,) with attitude R (3, 3), or each from its own, with derivatives."""
    rho = np.where(is_inverse, y[:, 5], 1.0)[:, None]
    away, far = y[:, :3] - r, is_inverse[:, None]
    direction = rho * away + np.where(far, bearing(y[:, 3:5]), 0.0)  # eq. 2.4 (rho = 1) and C.5: the brackets
    h = (direction[:, None] @ R)[:, 0]  # eqs. 2.4 and C.5: h^R = R^RW [...]
    is_ahead = h[:, 2] > MIN_COSINE * np.linalg.norm(h, axis=1)
    h = np.where(is_ahead[:, None], h, [0.0, 0.0, 1.0])
    xy = h[:, :2] / h[:, 2:]

    pinhole = np.zeros((len(y), 2, 3))  # d xy / d h of eq. 2.5
    pinhole[:, [0, 1], [0, 1]] = 1.0 / h[:, 2:]
    pinhole[:, :, 2] = -xy / h[:, 2:]
    by_h = lens.whitening(xy, 1.0) @ pinhole  # with the lens' distortion
    by_direction = by_h @ np.swapaxes(R, -1, -2)
    by_place = rho[:, :, None] * by_direction
    by_angles = np.where(far[..., None], by_direction @ bearing_by_angles(y[:, 3:5]), 0.0)
    by_rho = np.where(far[..., None], by_direction @ away[:, :, None], 0.0)
    by_pose = np.concatenate([-by_place, by_h @ skew(h)], axis=2)
    by_feature = np.concatenate([by_place, by_angles, by_rho], axis=2)
    return Predicted(lens.project(xy), is_ahead, by_pose, by_feature)  # eq. 2.5, distorted
