"""The inertial readings between the poses of a whole navigation, and what wheels say of its velocities.

What fixes the metre: the accelerometer feels every start, stop and turn, and the map's shape joins them all to one
scale. The filter's relative motions (odometry.py) have the scale it believed in when it made them.
Unknown beside the poses: a velocity each, biases that walk from block to block, the wheels' constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, skew
from station.motion.preintegration import Preintegration
from station.slam.mapping.inertial_bundle import WindowLinks, WindowStates, inertial_residuals
from station.slam.mapping.odometry import sparse_rows
from station.slam.mapping.odometry_bundle import HELD_SIGMA, BundleState

POSES_PER_BIAS = 20  # biases walk by a hundredth of what they are in the seconds that so many views take
# Before the drive: what data sheets of small IMUs allow.
SIGMA_BIAS = np.repeat([0.05, 0.3], 3)  # rad/s, m/s^2
SLIP_CAUCHY = 3.0  # sigmas: wheels that spin against a chair are outliers, not noise


@dataclass(frozen=True, slots=True, eq=False)
class WheelTerms:
    """The body's velocities as wheels have them: v_body = by_constants @ constants, known to sigma."""

    by_constants: FloatArray  # (N, 3, c)
    sigma: FloatArray  # (N, 3) m/s, infinite where nothing is known
    mean: FloatArray  # (c,) of the constants before the drive
    sigma_mean: FloatArray  # (c,)


class InertialTerms:
    """Motion terms of N linked poses (see MotionTerms)."""

    def __init__(
        self,
        links: Sequence[Preintegration],
        noise: ImuNoise,
        gravity: float,
        bias: FloatArray,
        wheels: WheelTerms | None,
    ) -> None:
        """Args: links: the N - 1 between neighbouring poses; bias: (6,) gyro, accel, as good as it is known."""
        self._links = WindowLinks.of(list(links))
        self._gravity = gravity
        self._wheels = wheels
        self._bias = bias
        n = len(links) + 1
        self._block: IntArray = np.arange(n) // POSES_PER_BIAS
        middle = [float(part.mean()) for part in np.split(self._times(), np.flatnonzero(np.diff(self._block)) + 1)]
        walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3)
        self._sigma_walk = walk * np.sqrt(np.diff(middle))[:, None]  # (B - 1, 6)
        self._velocity = slice(0, 3 * n)
        self._biases = slice(3 * n, 3 * n + 6 * len(middle))
        self.size = self._biases.stop + (0 if wheels is None else len(wheels.mean))

    def _times(self) -> FloatArray:
        return np.concatenate([[0.0], np.cumsum(self._links.duration_s)])

    def start(self, v_world: FloatArray) -> FloatArray:
        """BundleState.motion for velocities (N, 3): biases and wheels as they were known."""
        blocks = int(self._block[-1]) + 1
        wheels = np.zeros(0) if self._wheels is None else self._wheels.mean
        return np.concatenate([v_world.ravel(), np.tile(self._bias, blocks), wheels])

    def velocities(self, state: BundleState) -> FloatArray:
        """(N, 3) m/s."""
        return state.motion[self._velocity].reshape(-1, 3)

    def cost(self, state: BundleState) -> float:
        cost = 0.0
        for r, _, _ in self._parts(state, with_jacobians=False):
            cost += float((r * r).sum())
        if self._wheels is not None:
            r, _ = self._wheel_residuals(state)
            cost += float((SLIP_CAUCHY**2 * np.log1p(r**2 / SLIP_CAUCHY**2)).sum())
        return cost

    def normal_equations(self, state: BundleState) -> tuple[csc_matrix, FloatArray]:
        """See MotionTerms."""
        size = 6 * len(state.R_world_body) + self.size
        H, g = csc_matrix((size, size)), np.zeros(size)
        parts = [*self._parts(state, with_jacobians=True)]
        if self._wheels is not None:
            parts.append(self._wheel_rows(state))
        for r, J, columns in parts:
            jacobian = sparse_rows(J, columns, size)
            H = H + jacobian.T @ jacobian
            g += jacobian.T @ r.ravel()
        return (H + _held(state.R_world_body[0], size)).tocsc(), g

    def _parts(self, state: BundleState, with_jacobians: bool) -> list[tuple[FloatArray, FloatArray, IntArray]]:
        """Whitened residuals (k, r), their derivatives (k, r, c) and the columns (k, c) of those."""
        n = len(state.R_world_body)
        v = self.velocities(state)
        bias = state.motion[self._biases].reshape(-1, 6)
        states = WindowStates(state.R_world_body, v, state.p_world_body, bias[self._block], np.zeros((n, 3)))
        r, J = inertial_residuals(states, self._links, self._gravity)
        W = self._links.sqrt_information
        r = (W @ r[..., None])[..., 0]
        walked = np.diff(bias, axis=0) / self._sigma_walk
        first = (bias[:1] - self._bias) / SIGMA_BIAS
        if not with_jacobians:
            return [(a, a, np.zeros(0, dtype=np.int64)) for a in (r, walked, first)]
        # The window's rotations are perturbed from the left, these from the right.
        J[:, :, :3] = J[:, :, :3] @ state.R_world_body[:-1]
        J[:, :, 15:18] = J[:, :, 15:18] @ state.R_world_body[1:]
        i = np.arange(n - 1)[:, None]
        three, six = np.arange(3), np.arange(6)
        v_at, b_at = 6 * n, 6 * n + self._biases.start
        columns = np.hstack([
            6 * i + three, v_at + 3 * i + three, 6 * i + 3 + three, b_at + 6 * self._block[:-1, None] + six,
            6 * (i + 1) + three, v_at + 3 * (i + 1) + three, 6 * (i + 1) + 3 + three,
        ])  # fmt: skip
        k = np.arange(len(walked))[:, None]
        eye = np.eye(6) / self._sigma_walk[:, :, None]
        by_walk = np.concatenate([-eye, eye], axis=2)
        return [
            (r, W @ J[:, :, :24], columns),
            (walked, by_walk, np.hstack([b_at + 6 * k + six, b_at + 6 * (k + 1) + six])),
            (first, (np.eye(6) / SIGMA_BIAS[:, None])[None], b_at + six[None]),
        ]

    def _wheel_residuals(self, state: BundleState) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals (3 N + c,) of velocities and constants, and v_body (N, 3)."""
        wheels = self._wheels
        assert wheels is not None
        constants = state.motion[self._biases.stop :]
        v_body = np.einsum("nji,nj->ni", state.R_world_body, self.velocities(state))
        off = (v_body - wheels.by_constants @ constants) / wheels.sigma
        return np.concatenate([off.ravel(), (constants - wheels.mean) / wheels.sigma_mean]), v_body

    def _wheel_rows(self, state: BundleState) -> tuple[FloatArray, FloatArray, IntArray]:
        wheels = self._wheels
        assert wheels is not None
        n, c = len(state.R_world_body), len(wheels.mean)
        r, v_body = self._wheel_residuals(state)
        J = np.zeros((n, 3, 6 + c))
        J[:, :, :3] = skew(v_body)
        J[:, :, 3:6] = np.swapaxes(state.R_world_body, 1, 2)
        J[:, :, 6:] = -wheels.by_constants
        J /= wheels.sigma[:, :, None]
        rows = np.concatenate(
            [J.reshape(3 * n, 6 + c), np.hstack([np.zeros((c, 6)), np.diag(1.0 / wheels.sigma_mean)])]
        )
        at = 6 * n + self._biases.stop + np.arange(c)
        i = np.arange(n)[:, None]
        columns = np.hstack([6 * i + np.arange(3), 6 * n + 3 * i + np.arange(3), np.broadcast_to(at, (n, c))])
        columns = np.concatenate([np.repeat(columns, 3, axis=0), np.tile(columns[0], (c, 1))])
        robust = 1.0 / np.sqrt(1.0 + r**2 / SLIP_CAUCHY**2)
        return r * robust, (rows * robust[:, None])[:, None, :], columns


def _held(R_first: FloatArray, size: int) -> csc_matrix:
    """(size, size) that holds the first pose's yaw and position; gravity tells the rest."""
    block = np.zeros((6, 6))
    block[:3, :3] = np.outer(R_first[2], R_first[2])
    block[3:, 3:] = np.eye(3)
    at = np.repeat(np.arange(6), 6), np.tile(np.arange(6), 6)
    return csc_matrix((block.ravel() / HELD_SIGMA**2, at), shape=(size, size))
