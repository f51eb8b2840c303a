"""The head that carries the camera: its servos' errors in the state, and clones of where it is (docs/slam.md, sec. 9).

What images are compared with is a pose of the head, T_world_head = T_world_body @ T_body_head: cloned from the body's
with the servos' errors as they are estimated at that time, so that everything behind sees a camera fixed to what moves.
From the head's first turn on no landmark is in the state: tracks constrain the clones alone. With landmarks paths came
out 2 to 4 % too short (docs/studies/ukf.md, "A head that turns").
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray, skew
from station.motion.error_coordinates import ErrorKind, as_displacement, from_displacement
from station.motion.head import NUM_ERRORS, PLAY, SIGMA_PLAY_RAD, HeadPose, errors_before_the_drive
from station.slam.ukf.filter.roots import triangular
from station.slam.ukf.filter.state import PHI, XI_X, FilterState, add_clone, keep_landmarks


@dataclass(frozen=True, slots=True, eq=False)
class ServosKnown:
    """What is known of the errors of a head's servos (FilterState.head) between two pieces of tracking."""

    mean: FloatArray  # (NUM_ERRORS,)
    root: FloatArray  # (NUM_ERRORS, NUM_ERRORS) of their covariance

    @classmethod
    def learned(cls, state: FilterState) -> ServosKnown:
        return cls(state.head, triangular(state.S[state.head_rows]))


def turn_head(state: FilterState, head: HeadPose, known: ServosKnown | None) -> FilterState:
    """The servos' errors at the next time: their constants stay, their play changes.

    The play of each is a Gauss-Markov process: e <- stay e + change w, where stay^2 + (change / sigma)^2 = 1 keeps its
    spread. Errors enter the state when the head is turned for the first time, as they are `known` by then, and
    landmarks leave it.
    """
    if not len(state.head):
        known = known or ServosKnown(np.zeros(NUM_ERRORS), errors_before_the_drive(head.calibration))
        return _add_head(keep_landmarks(state, np.zeros(state.num_landmarks, dtype=bool)), known)
    change = np.minimum(head.sigma_change, SIGMA_PLAY_RAD)
    stay = np.ones(NUM_ERRORS)
    stay[PLAY] = np.sqrt(1.0 - (change / SIGMA_PLAY_RAD) ** 2)
    S = np.pad(state.S, ((0, 0), (0, 2)))
    S[state.head_rows] *= stay[:, None]
    S[state.head_rows, -2:][PLAY] = np.diag(change)
    return replace(state, head=stay * state.head, S=S)


def _add_head(state: FilterState, known: ServosKnown) -> FilterState:
    at, size = state.first_clone_row, len(known.mean)
    n, k = state.S.shape
    S = np.zeros((n + size, k + size))
    S[:at, :k], S[at + size :, :k] = state.S[:at], state.S[at:]
    S[at : at + size, k:] = known.root
    return replace(state, head=known.mean, S=S)


def add_head_clone(kind: ErrorKind, state: FilterState, head: HeadPose, frame_index: int) -> FilterState:
    """Remember where the head is; its error is the body's and the servos' together."""
    off = head.by_errors @ state.head
    T = head.T_body_head(off)
    axes, shifts = head.by_angles(off)
    arm = state.R @ T[:3, 3]
    R, x = state.R @ T[:3, :3], state.x + arm
    rows = head.by_errors @ state.S[state.head_rows]
    turn_body, moved_body = as_displacement(kind, state.R, state.x, state.S[PHI], state.S[XI_X])
    turn = turn_body + state.R @ axes @ rows
    moved = moved_body - skew(arm) @ turn_body + state.R @ shifts @ rows
    phi, xi = from_displacement(kind, R, x, turn, moved)
    omega = T[:3, :3].T @ (state.omega_body + axes @ head.rates)
    v = state.v + state.R @ (np.cross(state.omega_body, T[:3, 3]) + shifts @ head.rates)
    cloned = add_clone(state, frame_index)
    last = cloned.num_clones - 1
    S, clone_R, clone_x = cloned.S.copy(), cloned.clone_R.copy(), cloned.clone_x.copy()
    clone_v, clone_omega = cloned.clone_v.copy(), cloned.clone_omega.copy()
    S[cloned.clone_rows(last)] = np.vstack([phi, xi])
    clone_R[last], clone_x[last], clone_v[last], clone_omega[last] = R, x, v, omega
    return replace(cloned, S=S, clone_R=clone_R, clone_x=clone_x, clone_v=clone_v, clone_omega=clone_omega)
