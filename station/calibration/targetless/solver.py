"""Least squares with corners eliminated one by one (Schur complement); what is left is dense in states and border."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray
from station.calibration.camera_imu.priors import Prior
from station.calibration.camera_imu.unknowns import BIASES, GRAVITY
from station.calibration.targetless.rows import InertialRows, SightingRows
from station.calibration.targetless.tracks import Sightings
from station.calibration.targetless.unknowns import POINT, STATE

WEAKEST_POINT = 1e-6  # of a corner's information: keeps finite what only turning saw


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """H dx = -g of states and border, corners eliminated, and what gives the corners' steps back."""

    H: FloatArray  # (n, n)
    g: FloatArray  # (n,)
    first: IntArray  # (L,) image that saw each corner first
    num_images: IntArray  # (L,) in which it was seen
    by_states: list[FloatArray]  # of each corner: (POINT, STATE * images)
    by_border: FloatArray  # (L, POINT, BIASES)
    inverse: FloatArray  # (L, POINT, POINT)
    g_points: FloatArray  # (L, POINT)

    def points(self, dx: FloatArray, num_states: int) -> FloatArray:
        """(L, POINT): the corners' steps that belong to a step of the rest."""
        right = self.g_points + self.by_border @ dx[num_states : num_states + BIASES]
        for i, (first, images, by) in enumerate(zip(self.first, self.num_images, self.by_states, strict=True)):
            right[i] += by @ dx[STATE * first : STATE * (first + images)]
        return np.asarray(-(self.inverse @ right[..., None])[..., 0])


def equations(
    seen: Sightings,
    sighted: SightingRows,
    felt: InertialRows,
    priors: Sequence[Prior],
    num_states: int,
    border: int,
    damping: float,
) -> Equations:
    """Everything that was measured and known, with the corners' part of it damped."""
    n = num_states + border
    H, g = np.zeros((n, n)), np.zeros(n)
    _add_inertial(H, g, felt, num_states)
    b = slice(num_states, num_states + BIASES)
    for prior in priors:
        at = num_states + prior.columns
        H[np.ix_(at, at)] += prior.J.T @ prior.J
        g[at] += prior.J.T @ prior.residual
    order = np.argsort(seen.image, kind="stable")
    bounds = np.searchsorted(seen.image[order], np.arange(num_states // STATE + 1))
    for k in range(num_states // STATE):
        rows = order[bounds[k] : bounds[k + 1]]
        J_state, J_border = sighted.by_state[rows].reshape(-1, STATE), sighted.by_border[rows].reshape(-1, BIASES)
        r = sighted.residual[rows].ravel()
        s = slice(STATE * k, STATE * (k + 1))
        H[s, s] += J_state.T @ J_state
        H[s, b] += J_state.T @ J_border
        g[s] += J_state.T @ r
    flat = sighted.by_border.reshape(-1, BIASES)
    H[b, b] += flat.T @ flat
    g[b] += flat.T @ sighted.residual.ravel()
    starts = np.searchsorted(seen.corner, np.arange(seen.num_corners + 1))
    point_T = np.swapaxes(sighted.by_point, 1, 2)
    V = np.add.reduceat(point_T @ sighted.by_point, starts[:-1])
    V[:, range(POINT), range(POINT)] *= 1.0 + damping
    V[:, range(POINT), range(POINT)] += WEAKEST_POINT
    inverse = np.linalg.inv(V)
    by_border = np.add.reduceat(point_T @ sighted.by_border, starts[:-1])
    g_points = np.add.reduceat((point_T @ sighted.residual[..., None])[..., 0], starts[:-1])
    cross = point_T @ sighted.by_state  # (M, POINT, STATE)
    first = seen.image[starts[:-1]]
    num_images = seen.image[starts[1:] - 1] - first + 1
    by_states = []
    for i, (f, count) in enumerate(zip(first.tolist(), num_images.tolist(), strict=True)):
        W = np.zeros((POINT, count, STATE))
        own = slice(starts[i], starts[i + 1])
        W[:, seen.image[own] - f] = np.swapaxes(cross[own], 0, 1)
        W = W.reshape(POINT, -1)
        by_states.append(W)
        VW = inverse[i] @ W
        s = slice(STATE * f, STATE * (f + count))
        H[s, s] -= W.T @ VW
        H[s, b] -= VW.T @ by_border[i]
        g[s] -= VW.T @ g_points[i]
    VB = inverse @ by_border
    H[b, b] -= np.einsum("lpi,lpj->ij", by_border, VB)
    g[b] -= np.einsum("lpi,lp->i", VB, g_points)
    H[b, :num_states] = H[:num_states, b].T
    H[num_states:, :num_states] = H[:num_states, num_states:].T
    return Equations(H, g, first, num_images, by_states, by_border, inverse, g_points)


def _add_inertial(H: FloatArray, g: FloatArray, felt: InertialRows, num_states: int) -> None:
    gravity = num_states + np.arange(GRAVITY.start, GRAVITY.stop)
    for k, (r, J) in enumerate(zip(felt.residual, felt.by_states, strict=True)):
        s = slice(STATE * k, STATE * (k + 2))
        H[s, s] += J.T @ J
        g[s] += J.T @ r
        at = np.concatenate([gravity, num_states + BIASES + 6 * felt.node[k] + np.arange(12)])
        B = np.concatenate([felt.by_gravity[k], felt.by_bias[k]], axis=1)
        H[s, at] += J.T @ B
        H[np.ix_(at, at)] += B.T @ B
        g[at] += B.T @ r


def solved(H: FloatArray, right: FloatArray, free: IntArray, damping: float) -> FloatArray:
    """-H^-1 right over the free unknowns, 0 elsewhere. Raises DegenerateGeometry where something is left open."""
    A = H[np.ix_(free, free)]
    A[np.diag_indices_from(A)] *= 1.0 + damping
    out = np.zeros_like(right)
    try:
        out[free] = -cho_solve(cho_factor(A, overwrite_a=True, check_finite=False), right[free], check_finite=False)
    except np.linalg.LinAlgError as exc:
        raise DegenerateGeometry("what the recording shows leaves the motion or the calibration open") from exc
    return out
