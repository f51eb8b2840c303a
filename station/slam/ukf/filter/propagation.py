"""IMU propagation: exact mean per sample, sigma points for the rest (docs/slam.md, sec. 2; thesis eqs. B.7-B.10, B.13).

The right-invariant error of the group part propagates exactly linearly, whatever its size (log-linear property:
Barrau and Bonnabel, IEEE TAC 62(4), 2017, theorem 2). Only biases enter non-linearly. The columns of S are rotated so
that only the first six move the biases, which stand in its first rows: those are the sigma points that matter, 2 x 6
instead of 2 x (15 + 6m + 3p). Every other column is mapped by the closed form. The left-invariant and plain errors have
no such property: there the first 15 columns become sigma points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, skew
from station.motion import lie
from station.motion.error_coordinates import ErrorKind, difference_group, retract_group
from station.motion.preintegration import ImuSegment, integrate
from station.slam.ukf.filter.roots import shrink, triangular
from station.slam.ukf.filter.state import BIAS_ACCEL, BIAS_GYRO, CORE, PHI, XI_V, XI_X, FilterState


@dataclass(frozen=True, slots=True)
class PropagationConfig:
    error: ErrorKind
    use_sigma_points: bool  # False: analytic Jacobian (invariant EKF)
    spread: float  # sigma points lie that many standard deviations out
    gravity: float


def propagate(state: FilterState, imu: ImuSegment, noise: ImuNoise, config: PropagationConfig) -> FilterState:
    """The state at the end of the segment."""
    if len(imu.dt_s) == 0:
        return state
    # Only the first columns may move the first rows: the biases' six, or all fifteen that become sigma points.
    leading = 6 if config.error is ErrorKind.RIGHT else CORE
    L = shrink(state.S) if state.S[:leading, leading:].any() else state.S
    spread = config.spread
    is_right = config.error is ErrorKind.RIGHT
    active = 0 if not config.use_sigma_points else (6 if is_right else CORE)
    biases = np.concatenate([state.bias_gyro, state.bias_accel])

    # Sigma points: the mean, then +- spread times each active column.
    steps = np.concatenate([L[:, :active], -L[:, :active]], axis=1).T * spread  # (2 active, n)
    rows_p = state.first_landmark_row
    xi = np.concatenate([steps[:, XI_V], steps[:, XI_X], steps[:, rows_p:]], axis=1).reshape(
        2 * active, 2 + state.num_landmarks, 3
    )
    R_pts, X_pts = retract_group(config.error, state.R, state.X, steps[:, PHI], xi)
    b_pts = biases + steps[:, :6]
    R_all = np.concatenate([state.R[None], R_pts])
    X_all = np.concatenate([state.X[None], X_pts])
    b_all = np.concatenate([biases[None], b_pts])
    Rs, vs, xs = integrate(R_all, X_all[:, 0], X_all[:, 1], b_all[:, :3], b_all[:, 3:], imu, config.gravity)
    R_end, v_end, x_end = Rs[-1, 0], vs[-1, 0], xs[-1, 0]
    X_end = np.vstack([v_end, x_end, state.landmark_p])

    new = L.copy()
    columns = [new]
    noise_map, bias_map, F = _linear_maps(Rs[:, 0], vs[:, 0], xs[:, 0], imu, noise, config.gravity)
    core = slice(PHI.start, XI_X.stop)
    if active:
        X_pts_end = np.concatenate([vs[-1, 1:, None], xs[-1, 1:, None], X_pts[:, 2:]], axis=1)
        phi_end, xi_end = difference_group(config.error, R_end, X_end, Rs[-1, 1:], X_pts_end)
        ends = np.concatenate([phi_end[:, None], xi_end], axis=1).reshape(
            2 * active, 9 + 3 * state.num_landmarks
        )  # phi, v, x, landmarks
        odd = (ends[:active] - ends[active:]).T / (2.0 * spread)
        even = (ends[:active] + ends[active:]).T / (2.0 * spread)
        new[core, :active], new[rows_p:, :active] = odd[:9], odd[9:]
        curvature = np.zeros((len(L), active))
        curvature[core], curvature[rows_p:] = even[:9], even[9:]
        columns.append(curvature)
    if is_right:
        rest = slice(active, None)
        moved = F @ L[core, rest]
        if not active:  # biases through the analytic Jacobian (invariant EKF)
            moved = moved + bias_map @ L[:6, rest]
            new[rows_p:, rest] += _landmark_rows(state.landmark_p, bias_map[:3]) @ L[:6, rest]
        new[core, rest] = moved
    elif config.error is ErrorKind.LEFT:
        turn_back = R_end.T @ state.R
        tail = new[rows_p:, active:]
        new[rows_p:, active:] = (turn_back @ tail.reshape(state.num_landmarks, 3, tail.shape[1])).reshape(tail.shape)

    driven = np.zeros((len(L), 9 + 6))
    driven[core, :9] = noise_map
    driven[rows_p:, :9] = _landmark_rows(state.landmark_p, noise_map[:3])
    duration = float(np.sqrt(imu.dt_s.sum()))
    driven[BIAS_GYRO, 9:12] = np.eye(3) * noise.gyro_walk * duration
    driven[BIAS_ACCEL, 12:] = np.eye(3) * noise.accel_walk * duration
    _from_right(config.error, driven[:, :9], R_end, X_end, rows_p)
    columns.append(driven)
    return replace(
        state,
        t_imu_ns=imu.end_t_ns,
        R=R_end,
        v=v_end,
        x=x_end,
        S=shrink(np.concatenate(columns, axis=1)),
        omega_body=imu.end_gyro - state.bias_gyro,
    )


def _landmark_rows(p: FloatArray, phi_columns: FloatArray) -> FloatArray:
    """Right-invariant landmark errors (3p, c) that keep landmarks still while the rotation error moves by (3, c)."""
    return (skew(p) @ phi_columns).reshape(3 * len(p), phi_columns.shape[1])


def _linear_maps(
    Rs: FloatArray, vs: FloatArray, xs: FloatArray, imu: ImuSegment, noise: ImuNoise, gravity: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Right-invariant maps of the core error (phi, v, x) along the mean, in closed form.

    Returns:
        noise_map (9, 9): square root of what white IMU noise adds over the segment.
        bias_map (9, 6): derivative by constant gyro and accel bias.
        F (9, 9): transition of the error itself, which depends on gravity and time only.
    """
    dt = imu.dt_s
    N = len(dt)
    left_s = np.cumsum(dt[::-1])[::-1] - dt  # time from the end of step k to the end of the segment
    Jr_R = Rs[:-1] @ lie.so3_left_jacobian(imu.gyro * dt[:, None])  # body rate to world angle over the step
    B = np.zeros((N, 9, 6))
    B[:, :3, :3] = Jr_R
    B[:, 3:6, :3] = skew(vs[1:]) @ Jr_R
    B[:, 6:, :3] = skew(xs[1:]) @ Jr_R
    B[:, 3:6, 3:] = Rs[:-1]
    B[:, 6:, 3:] = Rs[:-1] * (0.5 * dt)[:, None, None]
    B = _transition(left_s, gravity) @ B
    scaled = B * (noise.densities * np.sqrt(dt)[:, None] * imu.noise_scale)[:, None, :]
    by_step = np.swapaxes(scaled, 0, 1).reshape(9, -1)
    noise_map = triangular(by_step) if N > 1 else np.hstack([by_step, np.zeros((9, 3))])
    bias_map = -np.einsum("nij,n->ij", B, dt)
    return noise_map, bias_map, _transition(np.array([dt.sum()]), gravity)[0]


def _transition(t_s: FloatArray, gravity: float) -> FloatArray:
    """F (N, 9, 9) of the right-invariant error over times t_s (N,): phi stays, gravity couples it into v and x."""
    g = skew(np.array([0.0, 0.0, -gravity]))
    F = np.broadcast_to(np.eye(9), (len(t_s), 9, 9)).copy()
    t = t_s[:, None, None]
    F[:, 3:6, :3] = t * g
    F[:, 6:, :3] = 0.5 * t * t * g
    F[:, 6:, 3:6] = t * np.eye(3)
    return F


def _from_right(kind: ErrorKind, columns: FloatArray, R: FloatArray, X: FloatArray, rows_p: int) -> None:
    """Rewrite small right-invariant errors (n, c) in place as errors of another kind, at the mean (R, X)."""
    if kind is ErrorKind.RIGHT:
        return
    phi = columns[PHI].copy()
    for i, rows in enumerate([XI_V, XI_X, *(slice(r, r + 3) for r in range(rows_p, len(columns), 3))]):
        still = columns[rows] - skew(X[i]) @ phi  # = displacement of the point itself
        columns[rows] = R.T @ still if kind is ErrorKind.LEFT else still
    if kind is ErrorKind.LEFT:
        columns[PHI] = R.T @ phi
