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

from shared.geometry import FloatArray, IntArray, gammas, skew, so3_exp, so3_log
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
class Orientation:
    """Rotation and angular rate at N times, with their derivatives by the knots that act."""

    R: FloatArray  # (N, 3, 3) R_target_body
    omega: FloatArray  # (N, 3) rad/s, body
    R_by_knots: FloatArray  # (N, ORDER, 3, 3) perturbation on the right of R
    omega_by_knots: FloatArray  # (N, ORDER, 3, 3)


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
        by_later = lie.so3_left_jacobian_inverse(-d)  # of d, by the knot after it
        by_earlier = -lie.so3_left_jacobian_inverse(d)
        share = weights.cumulative
        N, first = len(weights.segment), weights.segment
        R = self.R_knots[first]
        omega = np.zeros((N, 3))
        R_by = np.zeros((N, ORDER, 3, 3))
        R_by[:, 0] = np.eye(3)
        omega_by = np.zeros((N, ORDER, 3, 3))
        for j in range(1, ORDER):
            pair = first + j - 1
            turn, A_by = gammas(share[:, 0, j, None] * d[pair], (0, 1))
            A_by = np.swapaxes(A_by, 1, 2) * share[:, 0, j, None, None]  # by d, on the right of the turn
            back = np.swapaxes(turn, 1, 2)
            R = R @ turn
            carried = (back @ omega[..., None])[..., 0]
            omega = carried + share[:, 1, j, None] * d[pair]
            R_by[:, :j] = back[:, None] @ R_by[:, :j]
            omega_by[:, :j] = back[:, None] @ omega_by[:, :j]
            omega_by_d = skew(carried) @ A_by
            omega_by_d[:, [0, 1, 2], [0, 1, 2]] += share[:, 1, j, None]
            for knot, by in ((j - 1, by_earlier), (j, by_later)):
                R_by[:, knot] += A_by @ by[pair]
                omega_by[:, knot] += omega_by_d @ by[pair]
        return Orientation(R, omega, R_by, omega_by)

    def moved(self, step: FloatArray) -> Motion:
        """step (n, 6): rotation vector on the right, then metres, per knot."""
        return Motion(self.start_s, self.spacing_s, self.R_knots @ so3_exp(step[:, :3]), self.p_knots + step[:, 3:])


def motion_through(
    t_s: FloatArray, R: FloatArray, p: FloatArray, start_s: float, end_s: float, spacing_s: float
) -> Motion:
    """A motion that passes near the poses R (N, 3, 3), p (N, 3) at increasing times; before and after them it rests."""
    n = int(np.ceil((end_s - start_s) / spacing_s)) + ORDER - 1
    middle = start_s + spacing_s * (np.arange(n) + 1 - 0.5 * ORDER)  # of the time in which a knot acts
    inside = np.clip(middle, t_s[0], t_s[-1])
    R_knots = Slerp(t_s, Rotation.from_matrix(R))(inside).as_matrix()
    return Motion(start_s, spacing_s, np.asarray(R_knots, dtype=np.float64), CubicSpline(t_s, p)(inside))
