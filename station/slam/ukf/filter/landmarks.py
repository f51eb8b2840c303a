"""The p landmarks in the state: measuring, entering, leaving (docs/slam.md, sec. 5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, IntArray, skew
from station.motion.error_coordinates import ErrorKind
from station.slam.mapping.rolling_shutter import observation_pose
from station.slam.ukf.filter.measurement import linearise, regress
from station.slam.ukf.filter.state import PHI, FilterState
from station.slam.ukf.filter.update import Gate, Measurements, huber_weights, mahalanobis, select
from station.slam.ukf.filter.window import WindowRows
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame
from station.vision.lens import BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkMeasurement:
    """One frame's observations of the landmarks in the state."""

    rows: Measurements  # of those that passed
    index: IntArray  # (q,) landmarks that were observed
    passed: BoolArray  # (q,)
    distance2: FloatArray  # (q,) normalised innovations squared, two degrees each


def measure_landmarks(
    camera: CameraModel,
    kind: ErrorKind,
    state: FilterState,
    frame: TrackedFrame,
    gate: Gate,
    spread: float,
    use_sigma_points: bool,
    huber: float,
) -> LandmarkMeasurement:
    """Compare the observed landmarks with their prediction from the newest clone (thesis eqs. 2.9, B.11, B.12)."""
    _, index, at = np.intersect1d(state.landmark_id, frame.ids, assume_unique=True, return_indices=True)
    order = np.argsort(index)
    index, at = index[order], at[order]
    if not len(index):
        return LandmarkMeasurement(Measurements.none(state), index, np.zeros(0, dtype=bool), np.zeros(0))
    xy, p = frame.xy[at], state.landmark_p[index]
    W = camera.lens.whitening(xy, camera.sigma_px)
    if camera.line_delay_s:
        xy, p_now = _undo_row_delay(camera, state, frame.uv_px[at], xy, p)
    else:
        p_now = p
    R, x = state.clone_R[-1], state.clone_x[-1]
    S_pose = state.S[state.clone_rows(state.num_clones - 1)]
    S_p = state.S[state.first_landmark_row :].reshape(state.num_landmarks, 3, -1)[index]
    Z = np.concatenate([np.broadcast_to(S_pose, (len(index), *S_pose.shape)), S_p], axis=1)  # (q, 9, k)
    if use_sigma_points:
        local = Z @ np.swapaxes(Z, 1, 2)
        diagonal = np.arange(9)
        local[:, diagonal, diagonal] *= 1.0 + 1e-10
        local[:, diagonal, diagonal] += 1e-14
        fit = regress(camera, kind, R, x, p_now, xy, W, np.linalg.cholesky(local), spread)
    else:
        fit = linearise(camera, kind, R, x, p_now, xy, W)
    A = fit.H @ Z
    noise = fit.extra + np.eye(2)
    C = np.linalg.cholesky(noise)
    r = np.linalg.solve(C, fit.residual[..., None])[..., 0]
    A = np.linalg.solve(C, A)
    distance2 = mahalanobis(r, A)
    passed = fit.in_front & (distance2 < gate.limit(np.full(len(r), 2)))
    weight = huber_weights(distance2, np.full(len(r), 2.0), huber)[:, None]
    return LandmarkMeasurement(select(r * weight, A * weight[..., None], passed), index, passed, distance2)


def _undo_row_delay(
    camera: CameraModel, state: FilterState, uv_px: FloatArray, xy: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Observations as the middle row would have made them: shifted by the predicted motion between both exposures."""
    delay = camera.row_delay_s(uv_px[:, 1])
    q = len(p)
    R_now, x_now, v, omega = state.clone_R[-1], state.clone_x[-1], state.clone_v[-1], state.clone_omega[-1]
    R, x = observation_pose(np.broadcast_to(R_now, (q, 3, 3)), np.broadcast_to(x_now, (q, 3)), v, omega, delay)
    own = camera.to_camera(np.einsum("nji,nj->ni", R, p - x))
    middle = camera.to_camera((p - x_now) @ R_now)
    z_own, z_middle = np.maximum(own[:, 2:], 0.05), np.maximum(middle[:, 2:], 0.05)
    return xy + middle[:, :2] / z_middle - own[:, :2] / z_own, p


def add_landmarks(kind: ErrorKind, state: FilterState, ids: IntArray, p: FloatArray, rows: WindowRows) -> FilterState:
    """Let triangulated points (f, 3) enter the state with their covariance and cross-covariance (delayed start).

    From r = H_x dx + J dp + n:  dp = J^+ (r - H_x dx - n), so the new rows of S are -J^+ H_x S beside the square root
    of (J^T J)^-1 in three new columns. The part of r outside J's range was used in the window update.
    Source: Li and Mourikis, "Optimization-based estimator design", RSS 2012, sec. IV.
    """
    if not len(ids):
        return state
    f = len(ids)
    Q, T = np.linalg.qr(rows.J_p)  # J = Q T
    T_inverse = np.linalg.inv(T)
    pinv = T_inverse @ np.swapaxes(Q, 1, 2)
    by_state = -(pinv @ rows.A)  # (f, 3, k)
    correction = np.einsum("fik,fk->fi", pinv, rows.r)
    p = p + correction
    k = state.S.shape[1]
    S = np.zeros((state.size + 3 * f, k + 3 * f))
    S[: state.size, :k] = state.S
    for i in range(f):
        at = state.size + 3 * i
        S[at : at + 3, :k] = by_state[i]
        S[at : at + 3, k + 3 * i : k + 3 * i + 3] = T_inverse[i]
        if kind is ErrorKind.RIGHT:  # xi_p = dp - phi x p
            S[at : at + 3, :k] += skew(p[i]) @ state.S[PHI]
        elif kind is ErrorKind.LEFT:
            S[at : at + 3] = state.R.T @ S[at : at + 3]
    return replace(
        state,
        S=S,
        landmark_id=np.concatenate([state.landmark_id, ids]),
        landmark_p=np.concatenate([state.landmark_p, p]),
    )
