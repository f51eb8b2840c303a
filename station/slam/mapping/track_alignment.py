"""Gyroscope bias, velocity and gravity from a few seconds of tracks and readings, before any pose is known.

1. Gyroscope bias: with the right rotations, the epipolar plane normals of each pair of frames lie in one plane.
2. Velocity and gravity: linear, once rotations are known; points are eliminated; |g| is given.
Sources: Kneip and Lynen, ICCV 2013 (step 1); Dong-Si and Mourikis, IROS 2012 (step 2). pose_alignment.py starts from
the camera poses of a whole navigation instead.
"""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, homogeneous, skew, so3_exp
from station.motion.preintegration import Preintegration
from station.slam.mapping.inertial_bundle import (
    WindowTracks,
)
from station.vision.camera_model import CameraModel


def gyro_bias_from_tracks(links: list[Preintegration], tracks: WindowTracks, R_body_cam: FloatArray) -> FloatArray:
    """Gyro bias (3,) rad/s that makes the plane normals n = a x R b of each pair of frames coplanar.

    Gauss-Newton on t . n over the bias and one direction t per pair; the directions are projected out.
    """
    rays = homogeneous(tracks.xy)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    rays = rays @ R_body_cam.T  # body frame
    K = tracks.seen.shape[1]
    pairs = [(i, i + step) for step in (1, 3) for i in range(K - step)]
    bias = np.zeros(3)
    for iteration in range(10):
        H, gradient = np.eye(3) * 1e-9, np.zeros(3)
        for i, j in pairs:
            both = tracks.seen[:, i] & tracks.seen[:, j]
            if both.sum() < 12:
                continue
            r, J = _coplanarity(links[i:j], bias, rays[both, i], rays[both, j])
            scale = max(1.5 * float(np.median(np.abs(r))), 1e-5)
            weight = 1.0 / (1.0 + (r / scale) ** 2) if iteration > 1 else np.ones(len(r))
            H += (J * weight[:, None]).T @ J
            gradient += (J * weight[:, None]).T @ r
        step = np.linalg.solve(H, -gradient)
        bias = bias + np.clip(step, -0.1, 0.1)
        if float(np.abs(step).max()) < 1e-6:
            break
    return bias


def _coplanarity(
    links: list[Preintegration], bias: FloatArray, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals t . (a x R b) (n,) at the best direction t; their derivative (n, 3) by the bias, t's part taken out."""
    R, by_bias = np.eye(3), np.zeros((3, 3))
    for link in links:
        part = link.dR @ so3_exp(link.dR_by_bias @ (bias - link.bias[:3]))
        R, by_bias = R @ part, part.T @ by_bias + link.dR_by_bias
    normals = np.cross(a, b @ R.T)
    _, basis = np.linalg.eigh(normals.T @ normals)
    t = basis[:, 0]
    J = np.cross(t, a)[:, None, :] @ (-R @ skew(b) @ by_bias)  # t . (a x dRb) = (t x a) . dRb
    J = J[:, 0]
    Q = np.linalg.qr(normals @ basis[:, 1:])[0]
    return normals @ t, J - Q @ (Q.T @ J)


def solve_velocity_and_gravity(
    R: FloatArray, dp: FloatArray, t: FloatArray, tracks: WindowTracks, camera: CameraModel, gravity: float
) -> tuple[FloatArray, FloatArray]:
    """Velocity (3,) at the first pose and gravity (3,), in the first body frame.

    Pose k is at v0 t + g t^2 / 2 + dp. Each observation says that its point lies on a ray; the point is eliminated, and
    (v0, g) follow from linear least squares under |g| = gravity.
    """
    F, K = tracks.seen.shape
    rays = homogeneous(tracks.xy)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    rays = np.einsum("kij,fkj->fki", R @ camera.R_body_cam, rays)
    P = (np.eye(3) - rays[..., :, None] * rays[..., None, :]) * tracks.seen[..., None, None]
    s = dp + R @ camera.t_body_cam  # camera centre at zero velocity and gravity
    T = np.zeros((K, 3, 6))
    T[:, :, :3] = t[:, None, None] * np.eye(3)
    T[:, :, 3:] = 0.5 * (t * t)[:, None, None] * np.eye(3)
    weight = np.ones((F, K))
    y = np.zeros(6)
    for _ in range(3):
        Pw = P * weight[..., None, None]
        A = Pw.sum(axis=1) + 1e-9 * np.eye(3)
        PT = Pw @ T  # (F, K, 3, 6)
        Ps = (Pw @ s[..., None])[..., 0]
        A_inv_PT = np.linalg.solve(A, PT.sum(axis=1))
        A_inv_Ps = np.linalg.solve(A, Ps.sum(axis=1)[..., None])[..., 0]
        H = np.einsum("kia,fkib->ab", T, PT) - np.einsum("fia,fib->ab", PT.sum(axis=1), A_inv_PT)
        b = -np.einsum("kia,fki->a", T, Ps) + np.einsum("fia,fi->a", PT.sum(axis=1), A_inv_Ps)
        y = _with_gravity(0.5 * (H + H.T), b, gravity)
        points = np.einsum("fia,a->fi", A_inv_PT, y) + A_inv_Ps
        depth = np.linalg.norm(points[:, None] - (T @ y + s)[None], axis=2)
        weight = 1.0 / np.maximum(depth, 0.1) ** 2  # metres to angles
    return y[:3], y[3:]


def _with_gravity(H: FloatArray, b: FloatArray, gravity: float) -> FloatArray:
    """Minimiser (6,) of y^T H y / 2 - b^T y with |y[3:]| = gravity, by the multiplier's secular equation."""
    H_vv, H_vg, H_gg = H[:3, :3], H[:3, 3:], H[3:, 3:]
    reduce = np.linalg.solve(H_vv + 1e-12 * np.eye(3), np.column_stack([H_vg, b[:3]]))
    M = H_gg - H_vg.T @ reduce[:, :3]
    c = b[3:] - H_vg.T @ reduce[:, 3]
    eigen = np.linalg.eigh(0.5 * (M + M.T))
    w: FloatArray = np.asarray(eigen[0], dtype=np.float64)
    U = eigen[1]
    z = U.T @ c

    def length(shift: float) -> float:
        return float(np.linalg.norm(z / (w + shift)))

    smallest, largest = float(w[0]), float(w[2])
    reach = float(np.linalg.norm(z)) / gravity + largest + 1e-9
    low: float = 1e-12 * largest - smallest
    high: float = low + reach
    for _ in range(200):
        middle = 0.5 * (low + high)
        if length(middle) > gravity:
            low = middle
        else:
            high = middle
    shifted = w + 0.5 * (low + high)
    g = U @ (z / shifted)
    g *= gravity / max(float(np.linalg.norm(g)), 1e-9)
    return np.concatenate([reduce[:, 3] - reduce[:, :3] @ g, g])
