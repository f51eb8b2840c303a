"""What the camera measures of a point, and how that depends on the state (docs/slam.md, sec. 3; thesis eqs. B.11-B.12).

Everything is batched over observations. Residuals and derivatives are whitened: in units of the pixel noise, with the
lens' distortion undone at the measured point, so that their noise is the identity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, skew
from station.motion.error_coordinates import ErrorKind, pose_jacobian, retract_group
from station.vision.camera_model import CameraModel, normalised_points
from station.vision.lens import BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """Observations as a linear function of their local errors, plus noise: y = y_mean + H d + e, cov(e) = I + extra."""

    residual: FloatArray  # (N, 2) whitened measurement minus mean prediction
    H: FloatArray  # (N, 2, 9) by (phi, xi_x, xi_p)
    extra: FloatArray  # (N, 2, 2) covariance the linear function leaves unexplained; zero for Jacobians
    in_front: BoolArray  # (N,)


def point_coordinates(kind: ErrorKind, R: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How a landmark's error moves the point: d p / d phi and d p / d xi_p, each (..., 3, 3).

    Landmarks belong to the group of the current pose (R), so the rotation error moves them too in the right-invariant
    case: p = exp(phi) p_mean + ... .
    """
    identity = np.broadcast_to(np.eye(3), (*p.shape, 3))
    if kind is ErrorKind.RIGHT:
        return -skew(p), identity
    if kind is ErrorKind.LEFT:
        return np.zeros_like(identity), np.broadcast_to(R, identity.shape)
    return np.zeros_like(identity), identity


def linearise(
    camera: CameraModel, kind: ErrorKind, R: FloatArray, x: FloatArray, p: FloatArray, xy: FloatArray, W: FloatArray
) -> Regression:
    """Analytic version (invariant EKF): observations xy (N, 2) of landmarks p (N, 3) from the current pose R, x."""
    predicted, D, in_front = normalised_points(camera, R, x, p)
    by_pose = pose_jacobian(kind, np.broadcast_to(R, (len(p), 3, 3)), x, p)
    by_phi, by_xi = point_coordinates(kind, R, p)
    H = np.empty((len(p), 2, 9))
    H[..., :6] = D @ by_pose
    H[..., :3] += D @ R.T @ by_phi
    H[..., 6:] = D @ R.T @ by_xi
    residual = (W @ (xy - predicted)[..., None])[..., 0]
    return Regression(residual, W @ H, np.zeros((len(p), 2, 2)), in_front)


def regress(
    camera: CameraModel,
    kind: ErrorKind,
    R: FloatArray,
    x: FloatArray,
    p: FloatArray,
    xy: FloatArray,
    W: FloatArray,
    L: FloatArray,
    spread: float,
) -> Regression:
    """Unscented version: statistical linear regression over sigma points of each observation's own nine errors.

    An observation depends on (phi, xi_x, xi_p) only, so its cross-covariance with the whole state follows exactly from
    the regression on those nine (P_xy = P_xz P_zz^-1 P_zy): 18 sigma points per landmark, for any state size.
    Args:
        L: (N, 9, 9) lower-triangular square roots of the local covariances.
    Source: Arasaratnam and Haykin, IEEE TAC 54(6), 2009 (regression view); Brossard et al., IROS 2018 (the filter).
    """
    N = len(p)
    steps = np.concatenate([L, -L], axis=2).swapaxes(1, 2) * spread  # (N, 18, 9)
    X = np.stack([np.broadcast_to(x, p.shape), p], axis=1)[:, None]  # (N, 1, 2, 3)
    R_pts, X_pts = retract_group(kind, R, X, steps[..., :3], steps[..., 3:].reshape(N, 18, 2, 3))
    points, _, front = normalised_points(camera, R_pts, X_pts[..., 0, :], X_pts[..., 1, :])
    mean, _, in_front = normalised_points(camera, R, x, p)
    y_mean = (W @ mean[..., None])[..., 0]
    y = (W[:, None] @ points[..., None])[..., 0] - y_mean[:, None]  # (N, 18, 2)
    odd = (y[:, :9] - y[:, 9:]) / (2.0 * spread)  # (N, 9, 2): P_zy in whitened coordinates
    even = (y[:, :9] + y[:, 9:]) / (2.0 * spread)
    H = np.linalg.solve(np.swapaxes(L, 1, 2), odd).swapaxes(1, 2)  # H L = odd^T
    shift = even.sum(axis=1) / spread
    extra = even.swapaxes(1, 2) @ even
    residual = (W @ xy[..., None])[..., 0] - y_mean - shift
    return Regression(residual, np.asarray(H, dtype=np.float64), extra, in_front & front.all(axis=1))
