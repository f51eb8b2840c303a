"""Bundle adjustment of a whole navigation: poses and landmarks, and what is known of the motion between the poses.

COLMAP's bundle adjustment knows cameras only. A robot that turns on the spot before a blank wall is held together by
its odometry, so the motion between keyframes has residuals here, next to the reprojection errors: relative motions of
gyroscope and wheels, or the filter's (odometry.py); or the inertial readings themselves (inertial_terms.py), with
velocities and biases among the unknowns.
Source: Triggs et al., Bundle adjustment - a modern synthesis, 2000, sections 4.3 (robust weights) and 6.1 (Schur
complement); Levenberg-Marquardt after Madsen, Nielsen and Tingleff, Methods for non-linear least squares, 2004.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import bsr_matrix, csc_matrix
from scipy.sparse.linalg import splu

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray, skew, so3_exp, transform

HELD_SIGMA = 1e-4  # rad and m: the first pose stays where it is
# Equations are solved as full ones where so few unknowns depend on each other so much: their root would be full.
MAX_DENSE = 4200  # unknowns of the poses and their motion
MIN_FILLED = 0.05  # of the entries


@dataclass(frozen=True, slots=True, eq=False)
class BundleState:
    R_world_body: FloatArray  # (N, 3, 3)
    p_world_body: FloatArray  # (N, 3) m
    points: FloatArray  # (M, 3) m
    motion: FloatArray  # (e,) the unknowns that the motion terms bring along


class MotionTerms(Protocol):
    """Residuals of the motion between poses: functions of the poses and of unknowns of their own."""

    def cost(self, state: BundleState) -> float: ...

    def normal_equations(self, state: BundleState) -> tuple[csc_matrix, FloatArray]:
        """J^T J (6N + e, 6N + e) and J^T r: poses (rotation on the right, position), then BundleState.motion.

        With what holds the frame: of the first pose, all that the terms say nothing of.
        """
        ...


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
    H_motion: csc_matrix  # (6N + e, 6N + e)
    g_motion: FloatArray


def adjust(
    state: BundleState,
    seen: Observations,
    motion: MotionTerms,
    cauchy_px: float,
    damping: float = 1e-4,
    max_iterations: int = 10,
) -> BundleState:
    """Minimise reprojection (Cauchy loss of scale cauchy_px) and motion residuals.

    Args:
        damping: to begin with. What only the motion terms tell, such as the scale, hardly moves until it is small.
    """
    order = np.argsort(seen.point, kind="stable")
    cost = _cost(state, seen, motion, cauchy_px)
    for _ in range(max_iterations):
        linear = _linearise(state, seen, motion, _whitened(state, seen, cauchy_px), order)
        improved = False
        for _ in range(4):
            try:
                candidate = _step(state, linear, damping)
            except np.linalg.LinAlgError:  # they leave something open: it is held
                damping *= 10.0
                continue
            new_cost = _cost(candidate, seen, motion, cauchy_px)
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


def in_camera(state: BundleState, seen: Observations) -> tuple[FloatArray, FloatArray]:
    """Points (K, 3) m as each observation's camera has them, and how their pixels change with that (K, 2, 3) px/m."""
    _, depth, (_, p_cam) = _project(state, seen)
    return p_cam, _projection_jacobian(p_cam, depth, seen.focal_px)


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


def _cost(state: BundleState, seen: Observations, motion: MotionTerms, cauchy_px: float) -> float:
    residual, _, _ = _project(state, seen)
    visual = float((cauchy_px**2 * np.log1p((residual**2).sum(axis=1) / cauchy_px**2)).sum())
    return visual + motion.cost(state)


@dataclass(frozen=True, slots=True, eq=False)
class _Whitened:
    """Residuals of all observations and their derivatives, weighted by the robust loss."""

    weight: FloatArray  # (K,)
    residual: FloatArray  # (K, 2) px
    J_pose: FloatArray  # (K, 2, 6)
    J_point: FloatArray  # (K, 2, 3)


def _whitened(state: BundleState, seen: Observations, cauchy_px: float) -> _Whitened:
    residual, depth, (p_body, p_cam) = _project(state, seen)
    J_proj = _projection_jacobian(p_cam, depth, seen.focal_px)
    J_body = J_proj @ seen.T_cam_body[:3, :3]
    R_t = np.swapaxes(state.R_world_body[seen.keyframe], 1, 2)
    J_point = J_body @ R_t
    J_pose = np.concatenate([J_body @ skew(p_body), -J_point], axis=2)
    weight = np.sqrt(1.0 / (1.0 + (residual**2).sum(axis=1) / cauchy_px**2))
    weight[depth <= 0.02] = 0.0
    J_pose *= weight[:, None, None]
    J_point *= weight[:, None, None]
    return _Whitened(weight, residual * weight[:, None], J_pose, J_point)


def _linearise(
    state: BundleState, seen: Observations, motion: MotionTerms, whitened: _Whitened, by_point: IntArray
) -> _Linear:
    n, m = len(state.R_world_body), len(state.points)
    J_pose, J_point, r = whitened.J_pose, whitened.J_point, whitened.residual
    J_pose_t, J_point_t = np.swapaxes(J_pose, 1, 2), np.swapaxes(J_point, 1, 2)
    counts = np.bincount(seen.keyframe, minlength=n)
    W = bsr_matrix(
        (J_pose_t @ J_point, seen.point, np.concatenate([[0], np.cumsum(counts)])),
        shape=(6 * n, 3 * m),
        blocksize=(6, 3),
    )
    H, g = motion.normal_equations(state)
    return _Linear(
        U=_sum_by(seen.keyframe, J_pose_t @ J_pose, n),
        V=_sum_by(seen.point[by_point], (J_point_t @ J_point)[by_point], m),
        W=W,
        g_pose=_sum_by(seen.keyframe, (J_pose_t @ r[:, :, None])[:, :, 0], n),
        g_point=_sum_by(seen.point[by_point], (J_point_t @ r[:, :, None])[:, :, 0][by_point], m),
        H_motion=H,
        g_motion=g,
    )


def _sum_by(index: IntArray, values: FloatArray, size: int) -> FloatArray:
    """Sums of rows that share a (sorted) index."""
    out = np.zeros((size, *values.shape[1:]))
    if len(index):
        begin = np.flatnonzero(np.diff(index, prepend=-1))
        out[index[begin]] = np.add.reduceat(values, begin, axis=0)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """The damped problem without its landmarks (Schur complement): poses and the motion's unknowns."""

    V_inv: FloatArray  # (M, 3, 3)
    WV: bsr_matrix  # (6N, 3M) W V^-1
    solve: Callable[[FloatArray], FloatArray]  # of right sides (6N + e,) or (6N + e, c)

    def without_points(self, of_poses: FloatArray, of_points: FloatArray) -> FloatArray:
        """Right sides (6N + e, ...) of poses and motion less what the points (3M, ...) explain."""
        out = of_poses.copy()
        out[: self.WV.shape[0]] -= self.WV @ of_points
        return out


def _reduce(linear: _Linear, damping: float) -> _Reduced:
    n = len(linear.U)
    V = linear.V + np.eye(3) * (damping * np.trace(linear.V, axis1=1, axis2=2)[:, None, None] + 1e-9)
    V_inv = np.linalg.inv(V)
    W = linear.W
    WV = bsr_matrix((W.data @ V_inv[W.indices], W.indices, W.indptr), shape=W.shape, blocksize=(6, 3))
    H = linear.H_motion
    diagonal = np.zeros(H.shape[0])
    diagonal[: 6 * n] = np.einsum("nii->ni", linear.U).ravel()
    U = bsr_matrix((linear.U, np.arange(n), np.arange(n + 1)), shape=(6 * n, 6 * n))
    visual = (U - WV @ W.T.tobsr(blocksize=(3, 6))).tocoo()
    S = (H + csc_matrix((visual.data, (visual.row, visual.col)), shape=H.shape)).tocsc()
    S.setdiag(S.diagonal() + damping * (diagonal + H.diagonal()) + 1e-12)
    return _Reduced(V_inv, WV, factored(S))


def factored(S: csc_matrix) -> Callable[[FloatArray], FloatArray]:
    """What solves symmetric equations. Raises LinAlgError: they are not positive definite.

    A keyframe shares landmarks with few others: of a drive round three rooms, loops closed, 3 % of S are not zero, and
    6 % of its root.
    """
    if S.shape[0] <= MAX_DENSE and S.nnz > MIN_FILLED * S.shape[0] ** 2:
        factor = cho_factor(S.toarray(order="F"), overwrite_a=True, check_finite=False)
        return lambda rhs: np.asarray(cho_solve(factor, rhs, check_finite=False))
    try:  # without pivoting, which symmetric equations need only where they are not positive definite
        root = splu(S, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as exc:
        raise np.linalg.LinAlgError(str(exc)) from exc
    # A zero on the diagonal is not pivoted on either: rows change places then, and the signs of U say nothing.
    if not ((root.perm_r == root.perm_c).all() and (root.U.diagonal() > 0).all()):
        raise np.linalg.LinAlgError("not positive definite")
    return root.solve


def _step(state: BundleState, linear: _Linear, damping: float) -> BundleState:
    """One damped Gauss-Newton step; landmarks are eliminated first (Schur complement). Raises LinAlgError."""
    n = len(state.R_world_body)
    reduced = _reduce(linear, damping)
    x = reduced.solve(-reduced.without_points(_gradient(linear), linear.g_point.ravel()))
    pose = x[: 6 * n].reshape(n, 6)
    back = linear.g_point.ravel() + linear.W.T @ x[: 6 * n]
    points = state.points - (reduced.V_inv @ back.reshape(-1, 3, 1))[:, :, 0]
    return replace(
        state,
        R_world_body=state.R_world_body @ so3_exp(pose[:, :3]),
        p_world_body=state.p_world_body + pose[:, 3:],
        points=points,
        motion=state.motion + x[6 * n :],
    )


def _gradient(linear: _Linear) -> FloatArray:
    """(6N + e,) of poses and the motion's unknowns."""
    g = linear.g_motion.copy()
    g[: linear.g_pose.size] += linear.g_pose.ravel()
    return g


def information_on(
    state: BundleState, seen: Observations, motion: MotionTerms, cauchy_px: float, J: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What a solved problem says of further unknowns that all observations share, whatever poses and points become.

    Args:
        J: (K, 2, c) px, how the residuals change with them.
    Returns:
        Information (c, c) and score (c,): their step is the information's inverse times the score. In units of a pixel.
    Raises:
        DegenerateGeometry: observations and motion leave a pose, velocity or point open.
    """
    n, m, c = len(state.R_world_body), len(state.points), J.shape[2]
    by_point = np.argsort(seen.point, kind="stable")
    whitened = _whitened(state, seen, cauchy_px)
    linear = _linearise(state, seen, motion, whitened, by_point)
    J = J * whitened.weight[:, None, None]
    J_t = np.swapaxes(J, 1, 2)
    by_poses = np.zeros((len(linear.g_motion), c))
    by_poses[: 6 * n] = _sum_by(seen.keyframe, np.swapaxes(whitened.J_pose, 1, 2) @ J, n).reshape(6 * n, c)
    by_points = _sum_by(seen.point[by_point], (np.swapaxes(whitened.J_point, 1, 2) @ J)[by_point], m)
    try:
        reduced = _reduce(linear, 0.0)
    except np.linalg.LinAlgError as exc:
        raise DegenerateGeometry("the map's equations have no single solution") from exc
    B = reduced.without_points(by_poses, by_points.reshape(3 * m, c))
    g = reduced.without_points(_gradient(linear), linear.g_point.ravel())
    explained = reduced.V_inv @ by_points
    matrix = (J_t @ J).sum(axis=0) - np.einsum("mia,mib->ab", by_points, explained)
    score = np.einsum("kai,ki->a", J_t, whitened.residual) - np.einsum("mi,mia->a", linear.g_point, explained)
    solved = reduced.solve(np.column_stack([B, g]))
    matrix -= B.T @ solved[:, :c]
    return 0.5 * (matrix + matrix.T), -(score - B.T @ solved[:, c])
