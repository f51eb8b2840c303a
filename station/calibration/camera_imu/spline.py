"""A rigid body's motion in continuous time: a uniform B-spline of positions and a cumulative one of rotations.

Each sample and each image row is compared with the motion at its own time; velocity, acceleration and angular rate are
exact derivatives. Perturbations: R_i exp(delta) on the right of each rotation knot, + on each position knot.
Source: Sommer et al., Efficient Derivative Computation for Cumulative B-Splines on Lie Groups, CVPR 2020.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from shared.geometry import DIAGONAL, FloatArray, IntArray, skew, so3_exp, so3_log
from station.motion import lie

ORDER = 5  # knots that act on one time: with 5, quartic, the specific force is smooth


@cache
def blending_polynomials(order: int) -> FloatArray:
    """(order, order): row m holds the weight of a segment's m-th knot as a polynomial in u of 0..1, lowest power first.

    From the Cox-de Boor recursion for uniform knots.
    """
    pieces = [np.array([1.0])]  # of N_k(u + j), j = 0 .. k - 1
    for k in range(2, order + 1):
        higher = [np.zeros(k) for _ in range(k)]
        for j in range(k):
            if j < k - 1:
                higher[j] += np.polynomial.polynomial.polymul([j, 1.0], pieces[j]) / (k - 1)
            if j > 0:
                higher[j] += np.polynomial.polynomial.polymul([k - j, -1.0], pieces[j - 1]) / (k - 1)
        pieces = higher
    return np.array(pieces[::-1])


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Which knots act on each of N times, and by how much."""

    segment: IntArray  # (N,) index of the first of the ORDER knots
    blend: FloatArray  # (N, 3, ORDER): weights, their first and second derivative by time

    @property
    def cumulative(self) -> FloatArray:
        """(N, 3, ORDER): each knot's weight with those of all later ones."""
        return np.cumsum(self.blend[..., ::-1], axis=-1)[..., ::-1]


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """One factor of the rotation at N times, from one knot to the next: Exp(share * d)."""

    R: FloatArray  # (N, 3, 3)
    R_by_d: FloatArray  # (N, 3, 3) perturbation on the right of R
    omega_by_d: FloatArray  # (N, 3, 3) of the angular rate after it
    d_by_knots: FloatArray  # (N, 3, 6): of the knot before, of the knot after


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """Rotation and angular rate at N times, and what they are made of."""

    R: FloatArray  # (N, 3, 3) R_target_body
    omega: FloatArray  # (N, 3) rad/s, body
    turns: list[Turn]  # ORDER - 1

    def by_knots(self, by_R: FloatArray, by_omega: FloatArray | None = None) -> FloatArray:
        """Derivatives (N, m, ORDER, 3) by the knots' rotations of m numbers whose derivatives by R are known.

        From the last turn to the first, as the chain rule goes with few numbers of many unknowns.

        Args:
            by_R: (N, m, 3) by a perturbation on the right of R.
            by_omega: (N, m, 3); None: they do not depend on it.
        """
        N, m, _ = by_R.shape
        out = np.zeros((N, m, ORDER, 3))
        for j in range(ORDER - 1, 0, -1):
            turn = self.turns[j - 1]
            by_d = by_R @ turn.R_by_d
            if by_omega is not None:
                by_d += by_omega @ turn.omega_by_d
            out[:, :, j - 1 : j + 1] += (by_d @ turn.d_by_knots).reshape(N, m, 2, 3)
            back = np.swapaxes(turn.R, 1, 2)
            by_R = by_R @ back
            by_omega = None if by_omega is None else by_omega @ back
        out[:, :, 0] += by_R
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Of the body in the target's frame."""

    start_s: float
    spacing_s: float
    R_knots: FloatArray  # (n, 3, 3)
    p_knots: FloatArray  # (n, 3) m

    @property
    def num_segments(self) -> int:
        return len(self.p_knots) - ORDER + 1

    @property
    def end_s(self) -> float:
        return self.start_s + self.num_segments * self.spacing_s

    def weights(self, t_s: FloatArray) -> Weights:
        """Of times within start_s .. end_s."""
        position = (t_s - self.start_s) / self.spacing_s
        segment = np.clip(np.floor(position).astype(np.int64), 0, self.num_segments - 1)
        u = position - segment
        powers = u[:, None] ** np.arange(ORDER)
        polynomials = blending_polynomials(ORDER)
        blend = np.empty((len(t_s), 3, ORDER))
        for derivative in range(3):
            taken = np.polynomial.polynomial.polyder(polynomials, derivative, axis=1)
            blend[:, derivative] = powers[:, : taken.shape[1]] @ taken.T / self.spacing_s**derivative
        return Weights(segment, blend)

    def positions(self, weights: Weights) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position (N, 3) m, velocity m/s and acceleration m/s^2."""
        knots = self.p_knots[weights.segment[:, None] + np.arange(ORDER)]
        found = weights.blend @ knots
        return found[:, 0], found[:, 1], found[:, 2]

    def orientations(self, weights: Weights) -> Orientation:
        d = so3_log(np.swapaxes(self.R_knots[:-1], 1, 2) @ self.R_knots[1:])
        angle = np.linalg.norm(d, axis=1)
        axis = skew(d / np.maximum(angle, 1e-12)[:, None])
        axis2 = axis @ axis
        d_by_knots = np.concatenate([-lie.so3_left_jacobian_inverse(d), lie.so3_left_jacobian_inverse(-d)], axis=2)
        share, first = weights.cumulative, weights.segment
        R, omega, turns = self.R_knots[first], np.zeros((len(first), 3)), []
        for j in range(1, ORDER):
            pair = first + j - 1
            part, rate = share[:, 0, j], share[:, 1, j]
            turned, by_d = _about(axis[pair], axis2[pair], part * angle[pair])
            by_d *= part[:, None, None]
            carried = (omega[:, None] @ turned)[:, 0]
            omega_by_d = skew(carried) @ by_d
            omega_by_d[:, DIAGONAL, DIAGONAL] += rate[:, None]
            R, omega = R @ turned, carried + rate[:, None] * d[pair]
            turns.append(Turn(turned, by_d, omega_by_d, d_by_knots[pair]))
        return Orientation(R, omega, turns)

    def moved(self, step: FloatArray) -> Motion:
        """step (n, 6): rotation vector on the right, then metres, per knot."""
        return Motion(self.start_s, self.spacing_s, self.R_knots @ so3_exp(step[:, :3]), self.p_knots + step[:, 3:])


def _about(K: FloatArray, K2: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations (N, 3, 3) by angles (N,) about axes given as skew matrices K and their squares, with right Jacobians.

    As `shared.geometry.gammas`, with what the axes have in common taken out of the loop over the times.
    """
    sine, half = np.sin(angle), np.sin(0.5 * angle)
    R = sine[:, None, None] * K + (2.0 * half * half)[:, None, None] * K2
    # (1 - cos) / angle and 1 - sin / angle; numpy's sinc is sin(pi x) / (pi x)
    by = (1.0 - np.sinc(angle / np.pi))[:, None, None] * K2
    by -= (half * np.sinc(0.5 * angle / np.pi))[:, None, None] * K
    for matrix in (R, by):
        matrix[:, DIAGONAL, DIAGONAL] += 1.0
    return R, by


def motion_through(
    t_s: FloatArray, R: FloatArray, p: FloatArray, start_s: float, end_s: float, spacing_s: float
) -> Motion:
    """A motion that passes near the poses R (N, 3, 3), p (N, 3) at increasing times; before and after them it rests."""
    n = int(np.ceil((end_s - start_s) / spacing_s)) + ORDER - 1
    middle = start_s + spacing_s * (np.arange(n) + 1 - 0.5 * ORDER)  # of the time in which a knot acts
    inside = np.clip(middle, t_s[0], t_s[-1])
    R_knots = Slerp(t_s, Rotation.from_matrix(R))(inside).as_matrix()
    return Motion(start_s, spacing_s, np.asarray(R_knots, dtype=np.float64), CubicSpline(t_s, p)(inside))
