"""The filter's state: group element, biases, cloned poses, and the square-root covariance (docs/slam.md, 1).

Rows of the square root S (P = S S^T), in this order:
    b_omega 3, b_a 3 | phi 3, xi_v 3, xi_x 3 | wheels 0 or 2 | head | per clone: phi 3, xi_x 3 | per landmark: xi_p 3
Biases come first so that, S being lower triangular, only its first six columns move them: see propagation.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, IntArray, se3
from station.motion.error_coordinates import ErrorKind, retract_group

BIAS_GYRO = slice(0, 3)
BIAS_ACCEL = slice(3, 6)
PHI = slice(6, 9)
XI_V = slice(9, 12)
XI_X = slice(12, 15)
CORE = 15  # biases and group element without landmarks
NO_WHEELS = np.zeros(0)
NO_HEAD = np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """Mean and square-root covariance at one time. World: z up, metres."""

    t_imu_ns: int
    R: FloatArray  # (3, 3) R_world_body
    v: FloatArray  # (3,) m/s, world
    x: FloatArray  # (3,) m, world
    bias_gyro: FloatArray  # (3,) rad/s
    bias_accel: FloatArray  # (3,) m/s^2
    S: FloatArray  # (n, >= n) square root of the covariance, rows as above
    # (2,) speed over ground by commanded speed, and how far in front of its turning centre the body's origin lies, m:
    # what nobody knows of wheels before they roll. (0,) for a rig without wheels.
    wheels: FloatArray
    head: FloatArray  # (NUM_ERRORS,) of its servos, see station.motion.head; (0,) while the head was never turned
    omega_body: FloatArray  # (3,) rad/s at this time, bias removed: not estimated, kept for rolling shutter
    # Clones are poses of the head, which carries the camera: of the body itself while that was never turned.
    clone_R: FloatArray  # (m, 3, 3)
    clone_x: FloatArray  # (m, 3)
    clone_v: FloatArray  # (m, 3) velocity when cloned, for rolling shutter
    clone_omega: FloatArray  # (m, 3)
    clone_frame: IntArray  # (m,) ImageFrame.index
    landmark_id: IntArray  # (p,) track ids
    landmark_p: FloatArray  # (p, 3) world

    @property
    def num_clones(self) -> int:
        return len(self.clone_frame)

    @property
    def num_landmarks(self) -> int:
        return len(self.landmark_id)

    @property
    def size(self) -> int:
        return len(self.S)

    @property
    def wheel_rows(self) -> slice:
        return slice(CORE, CORE + len(self.wheels))

    @property
    def head_rows(self) -> slice:
        return slice(CORE + len(self.wheels), self.first_clone_row)

    @property
    def first_clone_row(self) -> int:
        return CORE + len(self.wheels) + len(self.head)

    @property
    def first_landmark_row(self) -> int:
        return self.first_clone_row + 6 * self.num_clones

    def clone_rows(self, index: int) -> slice:
        start = self.first_clone_row + 6 * index
        return slice(start, start + 6)

    def landmark_rows(self, index: int) -> slice:
        start = self.first_landmark_row + 3 * index
        return slice(start, start + 3)

    @property
    def covariance(self) -> FloatArray:
        """P (n, n)."""
        return self.S @ self.S.T

    @property
    def T_world_body(self) -> FloatArray:
        return se3(self.R, self.x)

    @property
    def X(self) -> FloatArray:
        """(2 + p, 3): velocity, position, landmarks; the translation columns of thesis eq. B.5."""
        return np.vstack([self.v, self.x, self.landmark_p])


def initial_state(
    t_imu_ns: int,
    R: FloatArray,
    v: FloatArray,
    x: FloatArray,
    bias_gyro: FloatArray,
    bias_accel: FloatArray,
    S: FloatArray,
) -> FilterState:
    """A state without wheels, clones and landmarks; S (15, k)."""
    return FilterState(
        t_imu_ns=t_imu_ns,
        R=R,
        v=v,
        x=x,
        bias_gyro=bias_gyro,
        bias_accel=bias_accel,
        S=S,
        wheels=NO_WHEELS,
        head=NO_HEAD,
        omega_body=np.zeros(3),
        clone_R=np.zeros((0, 3, 3)),
        clone_x=np.zeros((0, 3)),
        clone_v=np.zeros((0, 3)),
        clone_omega=np.zeros((0, 3)),
        clone_frame=np.zeros(0, dtype=np.int64),
        landmark_id=np.zeros(0, dtype=np.int64),
        landmark_p=np.zeros((0, 3)),
    )


def add_wheels(state: FilterState, wheels: FloatArray, sigma: FloatArray) -> FilterState:
    """Let the constants of the wheels (2,) enter a state that has none, with their standard deviations (2,)."""
    n, k = state.S.shape
    S = np.zeros((n + 2, k + 2))
    S[:CORE, :k], S[CORE + 2 :, :k] = state.S[:CORE], state.S[CORE:]
    S[CORE : CORE + 2, k:] = np.diag(sigma)
    return replace(state, wheels=wheels, S=S)


def retract(kind: ErrorKind, state: FilterState, dx: FloatArray) -> FilterState:
    """The state moved by the error dx (n,)."""
    p_rows = dx[state.first_landmark_row :].reshape(-1, 3)
    xi = np.vstack([dx[XI_V], dx[XI_X], p_rows])
    R, X = retract_group(kind, state.R, state.X, dx[PHI], xi)
    clones = dx[state.first_clone_row : state.first_landmark_row].reshape(-1, 6)
    clone_R, clone_X = retract_group(kind, state.clone_R, state.clone_x[:, None], clones[:, :3], clones[:, None, 3:])
    return replace(
        state,
        R=R,
        v=X[0],
        x=X[1],
        landmark_p=X[2:],
        bias_gyro=state.bias_gyro + dx[BIAS_GYRO],
        bias_accel=state.bias_accel + dx[BIAS_ACCEL],
        wheels=state.wheels + dx[state.wheel_rows],
        head=state.head + dx[state.head_rows],
        clone_R=clone_R,
        clone_x=clone_X[:, 0],
    )


def add_clone(state: FilterState, frame_index: int) -> FilterState:
    """Remember the current pose: its error is the current pose's error, so its rows are copies (stochastic cloning).

    Source: Roumeliotis and Burdick, ICRA 2002; in all three error kinds the Jacobian is a selection matrix.
    """
    at = state.first_landmark_row
    rows = np.vstack([state.S[PHI], state.S[XI_X]])
    return replace(
        state,
        S=np.vstack([state.S[:at], rows, state.S[at:]]),
        clone_R=np.concatenate([state.clone_R, state.R[None]]),
        clone_x=np.concatenate([state.clone_x, state.x[None]]),
        clone_v=np.concatenate([state.clone_v, state.v[None]]),
        clone_omega=np.concatenate([state.clone_omega, state.omega_body[None]]),
        clone_frame=np.append(state.clone_frame, np.int64(frame_index)),
    )


def remove_clone(state: FilterState, index: int) -> FilterState:
    """Marginalise one cloned pose: in square-root form its rows are simply left out."""
    keep = np.arange(state.num_clones) != index
    rows = np.ones(state.size, dtype=bool)
    rows[state.clone_rows(index)] = False
    return replace(
        state,
        S=state.S[rows],
        clone_R=state.clone_R[keep],
        clone_x=state.clone_x[keep],
        clone_v=state.clone_v[keep],
        clone_omega=state.clone_omega[keep],
        clone_frame=state.clone_frame[keep],
    )


def keep_landmarks(state: FilterState, keep: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> FilterState:
    """Marginalise the landmarks where keep (p,) is False."""
    if keep.all():
        return state
    rows = np.concatenate([np.ones(state.first_landmark_row, dtype=bool), np.repeat(keep, 3)])
    return replace(
        state, S=state.S[rows], landmark_id=state.landmark_id[keep], landmark_p=state.landmark_p[keep]
    )  # fmt: skip
