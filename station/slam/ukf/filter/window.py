"""Tracks that constrain the cloned poses without entering the state (docs/slam.md, sec. 6).

Source: Mourikis and Roumeliotis, ICRA 2007 (MSCKF). We project with I - Q Q^T instead of changing basis: the update
needs only A^T A and A^T r, and a projector is its own square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from station.motion.error_coordinates import ErrorKind, pose_jacobian
from station.slam.mapping.rolling_shutter import observation_pose
from station.slam.ukf.filter.state import FilterState
from station.slam.ukf.filter.update import Gate, Measurements, mahalanobis, select
from station.vision.camera_model import CameraModel, normalised_points
from station.vision.lens import BoolArray
from station.vision.triangulation import Triangulation, triangulate


@dataclass(frozen=True, slots=True, eq=False)
class WindowRows:
    """Whitened rows of F tracks against the clones."""

    r: FloatArray  # (F, 2M)
    A: FloatArray  # (F, 2M, k) derivative by the state, times S
    J_p: FloatArray  # (F, 2M, 3) derivative by the point
    dof: np.ndarray[tuple[int, ...], np.dtype[np.int64]]  # (F,) two per observation minus the point's three


def window_poses(camera: CameraModel, state: FilterState, uv_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Body poses (F, M, 3, 3), (F, M, 3) of each observation's own exposure, from the clones."""
    shape = uv_px.shape[:2]
    if camera.line_delay_s == 0.0:
        return np.broadcast_to(state.clone_R, (*shape, 3, 3)), np.broadcast_to(state.clone_x, (*shape, 3))
    return observation_pose(
        state.clone_R, state.clone_x, state.clone_v, state.clone_omega, camera.row_delay_s(uv_px[..., 1])
    )


def triangulate_window(
    camera: CameraModel, state: FilterState, uv_px: FloatArray, xy: FloatArray, seen: BoolArray
) -> Triangulation:
    """Points of tracks seen from the clones: (F, M, 2) observations."""
    R, x = window_poses(camera, state, uv_px)
    return triangulate(camera, R, x, xy, seen)


def window_rows(
    camera: CameraModel,
    kind: ErrorKind,
    state: FilterState,
    uv_px: FloatArray,
    xy: FloatArray,
    seen: BoolArray,
    p: FloatArray,
) -> WindowRows:
    """Linearised reprojections of points p (F, 3) in all clones that saw them; zero rows where not seen."""
    F, M = seen.shape
    R, x = window_poses(camera, state, uv_px)
    points = np.broadcast_to(p[:, None], (F, M, 3))
    predicted, D, in_front = normalised_points(camera, R, x, points)
    W = camera.lens.whitening(xy, camera.sigma_px) * (seen & in_front)[..., None, None]
    WD = W @ D
    r = (W @ (xy - predicted)[..., None])[..., 0].reshape(F, 2 * M)
    H = WD @ pose_jacobian(kind, R, x, points)  # (F, M, 2, 6)
    S_clones = state.S[state.first_clone_row : state.first_landmark_row].reshape(M, 6, -1)
    A = (H @ S_clones).reshape(F, 2 * M, state.S.shape[1])
    J_p = (WD @ np.swapaxes(R, 2, 3)).reshape(F, 2 * M, 3)
    return WindowRows(r, A, J_p, 2 * seen.sum(axis=1) - 3)


def without_points(rows: WindowRows) -> tuple[FloatArray, FloatArray]:
    """Residuals and A with the points' unknown positions projected out."""
    scale = np.linalg.norm(rows.J_p, axis=1, keepdims=True)  # columns differ by orders for distant points
    Q, _ = np.linalg.qr(rows.J_p / np.maximum(scale, 1e-12))
    Qt = np.swapaxes(Q, 1, 2)
    r = rows.r - np.einsum("fki,fi->fk", Q, np.einsum("fik,fk->fi", Qt, rows.r))
    return r, rows.A - Q @ (Qt @ rows.A)


def gated_window_rows(rows: WindowRows, gate: Gate, slack: float) -> tuple[Measurements, BoolArray, FloatArray]:
    """Rows of the tracks that pass the chi-square gate, which passed, and all squared distances.

    The projected residual lies in the projector's range, on which A A^T + I keeps its meaning.
    """
    r, A = without_points(rows)
    distance2 = mahalanobis(r, A)
    passed = distance2 < slack * gate.limit(rows.dof)
    kept = select(r, A, passed)
    used = np.abs(kept.A).max(axis=1, initial=0.0) > 0.0  # else rows of clones that did not see the track
    return Measurements(kept.r[used], kept.A[used]), passed, distance2
