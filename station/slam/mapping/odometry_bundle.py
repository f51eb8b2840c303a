"""Bundle adjustment of a whole navigation with odometry: poses, landmarks, drive scale and gyroscope bias together.

COLMAP's bundle adjustment knows cameras only. A robot that turns on the spot before a blank wall is held together by
its odometry, so relative motions between keyframes are residuals here, next to the reprojection errors: those of
gyroscope and wheels, or the filter's. Poses have neither velocities nor accelerometer biases: inertial_bundle.py
estimates those, over a window of some twenty poses.
Source: Triggs et al., Bundle adjustment - a modern synthesis, 2000, sections 4.3 (robust weights) and 6.1 (Schur
complement); Levenberg-Marquardt after Madsen, Nielsen and Tingleff, Methods for non-linear least squares, 2004.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import bsr_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu

from shared.geometry import FloatArray, IntArray, skew, so3_exp, so3_log, transform
from station.slam.mapping.odometry import RelativeMotions

NUM_SHARED = 4  # drive scale, gyroscope bias (3)
# Scale is a free gauge of the pictures, and noise would shrink it: held here, measured afterwards (metric.py).
DRIVE_SCALE_SIGMA = 0.002
GYRO_BIAS_SIGMA = 2e-3  # rad/s, around the bias the odometry was made with
FIRST_POSE_SIGMA = 1e-4
SLIP_CAUCHY = 3.0  # sigmas: wheels that spin against a chair are outliers, not noise
MAX_DENSE_KEYFRAMES = 700


@dataclass(frozen=True, slots=True, eq=False)
class BundleState:
    R_world_body: FloatArray  # (N, 3, 3)
    p_world_body: FloatArray  # (N, 3) m
    points: FloatArray  # (M, 3) m
    drive_scale: float  # real way per commanded way
    bias_change: FloatArray  # (3,) rad/s


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Sorted by keyframe, then point."""

    keyframe: IntArray  # (K,)
    point: IntArray  # (K,)
    xy: FloatArray  # (K, 2) normalised image coordinates
    T_cam_body: FloatArray  # (4, 4)
    focal_px: float


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The weighted problem around a state."""

    U: FloatArray  # (N, 6, 6)
    V: FloatArray  # (M, 3, 3)
    W: bsr_matrix  # (6N, 3M)
    g_pose: FloatArray  # (N, 6)
    g_point: FloatArray  # (M, 3)
    H_odometry: csc_matrix  # (6N + 4, 6N + 4)
    g_odometry: FloatArray


def adjust(
    state: BundleState, seen: Observations, odometry: RelativeMotions, cauchy_px: float, max_iterations: int = 10
) -> BundleState:
    """Minimise reprojection (Cauchy loss of scale cauchy_px) and odometry residuals."""
    damping = 1e-4
    order = np.argsort(seen.point, kind="stable")
    cost = _cost(state, seen, odometry, cauchy_px)
    for _ in range(max_iterations):
        linear = _linearise(state, seen, odometry, cauchy_px, order)
        improved = False
        for _ in range(4):
            candidate = _step(state, linear, damping)
            new_cost = _cost(candidate, seen, odometry, cauchy_px)
            if new_cost < cost:
                improved = True
                break
            damping *= 10.0
        if not improved:
            break
        gain = (cost - new_cost) / max(cost, 1e-12)
        state, cost, damping = candidate, new_cost, max(damping * 0.2, 1e-8)
        if gain < 2e-4:
            break
    return state


def reprojection_errors(state: BundleState, seen: Observations) -> FloatArray:
    """(K,) px; infinite behind the camera."""
    residual, depth, _ = _project(state, seen)
    return np.where(depth > 0.02, np.linalg.norm(residual, axis=1), np.inf)


def landmark_covariances(state: BundleState, seen: Observations, sigma_px: float) -> FloatArray:
    """(M, 3, 3) m^2 of the landmarks, given the poses, for pixel noise of sigma_px."""
    _, depth, (_, p_cam) = _project(state, seen)
    J = _projection_jacobian(p_cam, depth, seen.focal_px) @ (
        seen.T_cam_body[:3, :3] @ np.swapaxes(state.R_world_body[seen.keyframe], 1, 2)
    )
    order = np.argsort(seen.point, kind="stable")
    V = _sum_by(seen.point[order], (np.swapaxes(J, 1, 2) @ J)[order], len(state.points))
    return sigma_px**2 * np.asarray(np.linalg.inv(V + 1e-6 * np.eye(3)))


def _projection_jacobian(p_cam: FloatArray, depth: FloatArray, focal_px: float) -> FloatArray:
    """(K, 2, 3) px/m of pixels by camera coordinates."""
    z = np.where(np.abs(depth) < 0.02, 0.02, depth)
    J = np.zeros((len(z), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = focal_px / z
    J[:, :, 2] = -focal_px * p_cam[:, :2] / (z**2)[:, None]
    return J


def _project(state: BundleState, seen: Observations) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    R = state.R_world_body[seen.keyframe]
    p_body = np.einsum("nji,nj->ni", R, state.points[seen.point] - state.p_world_body[seen.keyframe])
    p_cam = transform(seen.T_cam_body, p_body)
    depth = p_cam[:, 2]
    safe = np.where(np.abs(depth) < 0.02, 0.02, depth)
    residual = (p_cam[:, :2] / safe[:, None] - seen.xy) * seen.focal_px
    return residual, depth, (p_body, p_cam)


def _cost(state: BundleState, seen: Observations, odometry: RelativeMotions, cauchy_px: float) -> float:
    residual, _, _ = _project(state, seen)
    visual = float((cauchy_px**2 * np.log1p((residual**2).sum(axis=1) / cauchy_px**2)).sum())
    weighted = _odometry_residual(state, odometry)[0]
    turn = float((weighted[:, :3] ** 2).sum())
    slip = float((SLIP_CAUCHY**2 * np.log1p((weighted[:, 3:] ** 2).sum(axis=1) / SLIP_CAUCHY**2)).sum())
    return visual + turn + slip + _prior_cost(state)


def _prior_cost(state: BundleState) -> float:
    bias = state.bias_change / GYRO_BIAS_SIGMA
    return ((state.drive_scale - 1.0) / DRIVE_SCALE_SIGMA) ** 2 + float(bias @ bias)


def _odometry_residual(state: BundleState, odometry: RelativeMotions) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N-1, 6) weighted residuals; relative rotations and translations as estimated."""
    R_a, R_b = state.R_world_body[:-1], state.R_world_body[1:]
    R_rel = np.swapaxes(R_a, 1, 2) @ R_b
    p_rel = np.einsum("nji,nj->ni", R_a, np.diff(state.p_world_body, axis=0))
    error = np.swapaxes(odometry.R, 1, 2) @ R_rel
    J_bias = np.swapaxes(odometry.R, 1, 2) @ odometry.R_sum
    turn = so3_log(error) + J_bias @ state.bias_change
    slip = p_rel - state.drive_scale * odometry.p
    weighted = np.hstack([turn / odometry.sigma_rotation[:, None], slip / odometry.sigma_position])
    return weighted, R_rel, p_rel


def _linearise(
    state: BundleState, seen: Observations, odometry: RelativeMotions, cauchy_px: float, by_point: IntArray
) -> _Linear:
    n, m = len(state.R_world_body), len(state.points)
    residual, depth, (p_body, p_cam) = _project(state, seen)
    J_proj = _projection_jacobian(p_cam, depth, seen.focal_px)
    J_body = J_proj @ seen.T_cam_body[:3, :3]
    R_t = np.swapaxes(state.R_world_body[seen.keyframe], 1, 2)
    J_point = J_body @ R_t
    J_pose = np.concatenate([J_body @ skew(p_body), -J_point], axis=2)
    weight = np.sqrt(1.0 / (1.0 + (residual**2).sum(axis=1) / cauchy_px**2))
    weight[depth <= 0.02] = 0.0
    r = residual * weight[:, None]
    J_pose *= weight[:, None, None]
    J_point *= weight[:, None, None]
    J_pose_t, J_point_t = np.swapaxes(J_pose, 1, 2), np.swapaxes(J_point, 1, 2)
    counts = np.bincount(seen.keyframe, minlength=n)
    W = bsr_matrix(
        (J_pose_t @ J_point, seen.point, np.concatenate([[0], np.cumsum(counts)])),
        shape=(6 * n, 3 * m),
        blocksize=(6, 3),
    )
    H, g = _odometry_normal(state, odometry)
    return _Linear(
        U=_sum_by(seen.keyframe, J_pose_t @ J_pose, n),
        V=_sum_by(seen.point[by_point], (J_point_t @ J_point)[by_point], m),
        W=W,
        g_pose=_sum_by(seen.keyframe, (J_pose_t @ r[:, :, None])[:, :, 0], n),
        g_point=_sum_by(seen.point[by_point], (J_point_t @ r[:, :, None])[:, :, 0][by_point], m),
        H_odometry=H,
        g_odometry=g,
    )


def _sum_by(index: IntArray, values: FloatArray, size: int) -> FloatArray:
    """Sums of rows that share a (sorted) index."""
    out = np.zeros((size, *values.shape[1:]))
    if len(index):
        begin = np.flatnonzero(np.diff(index, prepend=-1))
        out[index[begin]] = np.add.reduceat(values, begin, axis=0)
    return out


def _odometry_normal(state: BundleState, odometry: RelativeMotions) -> tuple[csc_matrix, FloatArray]:
    """Normal equations of odometry and priors, over poses and the shared unknowns."""
    n = len(state.R_world_body)
    size = 6 * n + NUM_SHARED
    weighted, R_rel, p_rel = _odometry_residual(state, odometry)
    k = n - 1
    J = np.zeros((k, 6, 12 + NUM_SHARED))
    R_a_t = np.swapaxes(state.R_world_body[:-1], 1, 2)
    J[:, :3, 0:3] = -np.swapaxes(R_rel, 1, 2)
    J[:, :3, 6:9] = np.eye(3)
    J[:, 3:, 0:3] = skew(p_rel)
    J[:, 3:, 3:6] = -R_a_t
    J[:, 3:, 9:12] = R_a_t
    J[:, 3:, 12] = -odometry.p
    J[:, :3, 13:16] = np.swapaxes(odometry.R, 1, 2) @ odometry.R_sum
    J[:, :3] /= odometry.sigma_rotation[:, None, None]
    J[:, 3:] /= odometry.sigma_position[:, :, None]
    robust = 1.0 / np.sqrt(1.0 + (weighted[:, 3:] ** 2).sum(axis=1) / SLIP_CAUCHY**2)
    J[:, 3:] *= robust[:, None, None]
    weighted = weighted.copy()
    weighted[:, 3:] *= robust[:, None]
    columns = np.hstack(
        [
            6 * np.arange(k)[:, None] + np.arange(12),
            np.broadcast_to(6 * n + np.arange(NUM_SHARED), (k, NUM_SHARED)),
        ]
    )
    rows = np.repeat(np.arange(6 * k), 12 + NUM_SHARED)
    flat = np.repeat(columns, 6, axis=0).ravel()
    jacobian = csc_matrix((J.ravel(), (rows, flat)), shape=(6 * k, size))
    prior = np.zeros(size)
    prior[:6] = FIRST_POSE_SIGMA**-2
    prior[6 * n] = DRIVE_SCALE_SIGMA**-2
    prior[6 * n + 1 :] = GYRO_BIAS_SIGMA**-2
    g = jacobian.T @ weighted.ravel()
    g[6 * n] += (state.drive_scale - 1.0) / DRIVE_SCALE_SIGMA**2
    g[6 * n + 1 :] += state.bias_change / GYRO_BIAS_SIGMA**2
    return (jacobian.T @ jacobian + diags(prior)).tocsc(), g


def _step(state: BundleState, linear: _Linear, damping: float) -> BundleState:
    """One damped Gauss-Newton step; landmarks are eliminated first (Schur complement)."""
    n = len(state.R_world_body)
    V = linear.V + np.eye(3) * (damping * np.trace(linear.V, axis1=1, axis2=2)[:, None, None] + 1e-9)
    V_inv = np.linalg.inv(V)
    W = linear.W
    WV = bsr_matrix((W.data @ V_inv[W.indices], W.indices, W.indptr), shape=W.shape, blocksize=(6, 3))
    reduced = WV @ W.T.tobsr(blocksize=(3, 6))
    H = linear.H_odometry
    diagonal = np.zeros(H.shape[0])
    diagonal[: 6 * n] = np.einsum("nii->ni", linear.U).ravel()
    rhs = -linear.g_odometry.copy()
    rhs[: 6 * n] -= linear.g_pose.ravel() - (WV @ linear.g_point.ravel())
    damp = damping * (diagonal + H.diagonal()) + 1e-12
    U = bsr_matrix((linear.U, np.arange(n), np.arange(n + 1)), shape=(6 * n, 6 * n))
    if n <= MAX_DENSE_KEYFRAMES:
        S = H.toarray()
        S[: 6 * n, : 6 * n] += U.toarray() - reduced.toarray()
        S[np.diag_indices_from(S)] += damp
        x = cho_solve(cho_factor(S, check_finite=False), rhs)
    else:
        visual = (U - reduced).tocoo()
        S_sparse = H + csc_matrix((visual.data, (visual.row, visual.col)), shape=H.shape)
        S_sparse.setdiag(S_sparse.diagonal() + damp)
        x = splu(S_sparse.tocsc()).solve(rhs)
    pose = x[: 6 * n].reshape(n, 6)
    back = linear.g_point.ravel() + W.T @ x[: 6 * n]
    points = state.points - (V_inv @ back.reshape(-1, 3, 1))[:, :, 0]
    return replace(
        state,
        R_world_body=state.R_world_body @ so3_exp(pose[:, :3]),
        p_world_body=state.p_world_body + pose[:, 3:],
        points=points,
        drive_scale=state.drive_scale + float(x[6 * n]),
        bias_change=state.bias_change + x[6 * n + 1 :],
    )
