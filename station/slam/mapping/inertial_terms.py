"""The inertial readings between the poses of a whole navigation, and how far wheels have rolled between them.

What fixes the metre: the accelerometer feels every start, stop and turn, and the map's shape joins them all to one
scale. The filter's relative motions (odometry.py) have the scale it believed in when it made them.
Unknown beside the poses: a velocity each, biases that walk from block to block, the wheels' constants, and by how much
a head that carries the camera is off at each pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, diags_array

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, skew, so3_exp
from station.motion import lie
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
    """What is known of the wheels' constants before the drive; the links say how far they rolled by them."""

    mean: FloatArray  # (c,)
    sigma_mean: FloatArray  # (c,)


@dataclass(frozen=True, slots=True, eq=False)
class HeadTerms:
    """Where the poses of the map are those of a head: it is off by two angles (pan, tilt) at each."""

    R_body_head: FloatArray  # (N, 3, 3) as far as is known
    t_body_head: FloatArray  # (N, 3) m
    axes: FloatArray  # (N, 3, 2) how its rotation changes with the angles, in body axes
    shifts: FloatArray  # (N, 3, 2) m/rad, and how its position does
    sigma_rad: float  # of the angles

    def body(self, state: BundleState, off: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (N, 3, 3) and positions (N, 3) of the body, of angles that are `off` (N, 2)."""
        turn, t = self._moved(off)
        R = state.R_world_body @ np.swapaxes(self.R_body_head, 1, 2) @ so3_exp(-turn)
        return R, state.p_world_body - np.einsum("nij,nj->ni", R, t)

    def body_by_head(self, R_world_body: FloatArray, off: FloatArray) -> FloatArray:
        """(N, 6, 8): how the body's rotation (on the right) and position change with the head's, and the angles."""
        turn, t = self._moved(off)
        J = np.zeros((len(off), 6, 8))
        J[:, :3, :3] = so3_exp(turn) @ self.R_body_head
        J[:, :3, 6:] = -lie.so3_left_jacobian(turn) @ self.axes
        J[:, 3:, 3:6] = np.eye(3)
        J[:, 3:] += R_world_body @ skew(t) @ J[:, :3]
        J[:, 3:, 6:] -= R_world_body @ self.shifts
        return J

    def _moved(self, off: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotation vectors (N, 3) by which the head is turned too far, and positions (N, 3) of it on the body."""
        turn = np.einsum("nij,nj->ni", self.axes, off)
        return turn, self.t_body_head + np.einsum("nij,nj->ni", self.shifts, off)


class InertialTerms:
    """Motion terms of N linked poses (see MotionTerms)."""

    def __init__(
        self,
        links: Sequence[Preintegration],
        noise: ImuNoise,
        gravity: float,
        bias: FloatArray,
        wheels: WheelTerms | None,
        head: HeadTerms | None = None,
    ) -> None:
        """Args: links: the N - 1 between neighbouring poses; bias: (6,) gyro, accel, as good as it is known; head: of
        poses that are a head's.
        """
        self._links = WindowLinks.of(list(links))
        self._gravity = gravity
        self._wheels = wheels
        self._ways = None if wheels is None else _Ways.of(links, len(wheels.mean))
        self._head = head
        self._bias = bias
        n = len(links) + 1
        self._block: IntArray = np.arange(n) // POSES_PER_BIAS
        middle = [float(part.mean()) for part in np.split(self._times(), np.flatnonzero(np.diff(self._block)) + 1)]
        walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3)
        self._sigma_walk = walk * np.sqrt(np.diff(middle))[:, None]  # (B - 1, 6)
        self._velocity = slice(0, 3 * n)
        self._biases = slice(3 * n, 3 * n + 6 * len(middle))
        self._constants = slice(self._biases.stop, self._biases.stop + (0 if wheels is None else len(wheels.mean)))
        self._angles = slice(self._constants.stop, self._constants.stop + (0 if head is None else 2 * n))
        self.size = self._angles.stop

    @property
    def has_head(self) -> bool:
        return self._head is not None

    def _times(self) -> FloatArray:
        return np.concatenate([[0.0], np.cumsum(self._links.duration_s)])

    def start(self, v_world: FloatArray) -> FloatArray:
        """BundleState.motion for velocities (N, 3): biases and wheels as they were known."""
        blocks = int(self._block[-1]) + 1
        wheels = np.zeros(0) if self._wheels is None else self._wheels.mean
        angles = np.zeros(self._angles.stop - self._angles.start)
        return np.concatenate([v_world.ravel(), np.tile(self._bias, blocks), wheels, angles])

    def velocities(self, state: BundleState) -> FloatArray:
        """(N, 3) m/s."""
        return state.motion[self._velocity].reshape(-1, 3)

    def _body(self, state: BundleState) -> tuple[FloatArray, FloatArray]:
        """Rotations (N, 3, 3) and positions (N, 3) of what carries the IMU."""
        if self._head is None:
            return state.R_world_body, state.p_world_body
        return self._head.body(state, state.motion[self._angles].reshape(-1, 2))

    def cost(self, state: BundleState) -> float:
        cost = 0.0
        if self._head is not None:
            cost += float(((state.motion[self._angles] / self._head.sigma_rad) ** 2).sum())
        for r, _, _ in self._parts(state, with_jacobians=False):
            cost += float((r * r).sum())
        if self._wheels is not None:
            r, _, _ = self._wheel_residuals(state)
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
        if self._head is not None:
            H, g = self._of_head(state, self._head, H, g)
        return (H + _held(state.R_world_body[0], size)).tocsc(), g

    def _of_head(
        self, state: BundleState, head: HeadTerms, H: csc_matrix, g: FloatArray
    ) -> tuple[csc_matrix, FloatArray]:
        """Equations of the body's poses as those of the head's, and of how far its angles are off."""
        n = len(state.R_world_body)
        first = 6 * n + self._angles.start
        i = np.arange(n)[:, None]
        pose, angles = 6 * i + np.arange(6), first + 2 * i + np.arange(2)
        off = state.motion[self._angles].reshape(-1, 2)
        by = head.body_by_head(self._body(state)[0], off)
        rows = np.broadcast_to(pose[:, :, None], by.shape)
        columns = np.broadcast_to(np.hstack([pose, angles])[:, None, :], by.shape)
        rest = np.arange(6 * n, len(g))
        J = csc_matrix(
            (
                np.concatenate([by.ravel(), np.ones(len(rest))]),
                (np.concatenate([rows.ravel(), rest]), np.concatenate([columns.ravel(), rest])),
            ),
            shape=H.shape,
        )
        known = np.zeros(len(g))
        known[first:] = head.sigma_rad**-2
        g = J.T @ g
        g[first:] += off.ravel() * known[first:]
        return (J.T @ H @ J + diags_array(known)).tocsc(), g

    def _parts(self, state: BundleState, with_jacobians: bool) -> list[tuple[FloatArray, FloatArray, IntArray]]:
        """Whitened residuals (k, r), their derivatives (k, r, c) and the columns (k, c) of those."""
        n = len(state.R_world_body)
        v = self.velocities(state)
        bias = state.motion[self._biases].reshape(-1, 6)
        R, p = self._body(state)
        states = WindowStates(R, v, p, bias[self._block], np.zeros((n, 3)))
        r, J = inertial_residuals(states, self._links, self._gravity)
        W = self._links.sqrt_information
        r = (W @ r[..., None])[..., 0]
        walked = np.diff(bias, axis=0) / self._sigma_walk
        first = (bias[:1] - self._bias) / SIGMA_BIAS
        if not with_jacobians:
            return [(a, a, np.zeros(0, dtype=np.int64)) for a in (r, walked, first)]
        # The window's rotations are perturbed from the left, these from the right.
        J[:, :, :3] = J[:, :, :3] @ R[:-1]
        J[:, :, 15:18] = J[:, :, 15:18] @ R[1:]
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

    def _wheel_residuals(self, state: BundleState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Whitened residuals (3 L + c,) of ways and constants; rotations (L, 3, 3) at the ways' begins, and the ways
        (L, 3) by the poses.
        """
        wheels, ways = self._wheels, self._ways
        assert wheels is not None and ways is not None
        constants = state.motion[self._constants]
        R, p = self._body(state)
        R_first = R[ways.first]
        moved = np.einsum("nji,nj->ni", R_first, p[ways.first + 1] - p[ways.first])
        off = np.einsum("nij,nj->ni", ways.whitening, moved - ways.by_constants @ constants)
        return np.concatenate([off.ravel(), (constants - wheels.mean) / wheels.sigma_mean]), R_first, moved

    def _wheel_rows(self, state: BundleState) -> tuple[FloatArray, FloatArray, IntArray]:
        wheels, ways = self._wheels, self._ways
        assert wheels is not None and ways is not None
        n, c, k = len(state.R_world_body), len(wheels.mean), len(ways.first)
        r, R_first, moved = self._wheel_residuals(state)
        R_t = np.swapaxes(R_first, 1, 2)
        J = ways.whitening @ np.concatenate([skew(moved), -R_t, R_t, -ways.by_constants], axis=2)
        rows = np.concatenate(
            [J.reshape(3 * k, 9 + c), np.hstack([np.zeros((c, 9)), np.diag(1.0 / wheels.sigma_mean)])]
        )
        at = 6 * n + self._biases.stop + np.arange(c)
        i = 6 * ways.first[:, None]
        columns = np.hstack([i + np.arange(6), i + 9 + np.arange(3), np.broadcast_to(at, (k, c))])
        of_constants = np.concatenate([np.arange(9), at])
        columns = np.concatenate([np.repeat(columns, 3, axis=0), np.tile(of_constants, (c, 1))])
        robust = 1.0 / np.sqrt(1.0 + r**2 / SLIP_CAUCHY**2)
        return r * robust, (rows * robust[:, None])[:, None, :], columns


@dataclass(frozen=True, slots=True, eq=False)
class _Ways:
    """How far wheels rolled along those links of which they say it."""

    first: IntArray  # (L,) the pose that each begins at
    by_constants: FloatArray  # (L, 3, c) m
    whitening: FloatArray  # (L, 3, 3)

    @classmethod
    def of(cls, links: Sequence[Preintegration], num_constants: int) -> _Ways:
        known = [(k, link.rolled) for k, link in enumerate(links) if link.rolled is not None]
        covariance = np.array([way.covariance for _, way in known]).reshape(-1, 3, 3)
        return cls(
            np.array([k for k, _ in known], dtype=np.int64),
            np.array([way.by_constants for _, way in known]).reshape(-1, 3, num_constants),
            np.linalg.inv(np.linalg.cholesky(covariance)),
        )


def _held(R_first: FloatArray, size: int) -> csc_matrix:
    """(size, size) that holds the first pose's yaw and position; gravity tells the rest."""
    block = np.zeros((6, 6))
    block[:3, :3] = np.outer(R_first[2], R_first[2])
    block[3:, 3:] = np.eye(3)
    at = np.repeat(np.arange(6), 6), np.tile(np.arange(6), 6)
    return csc_matrix((block.ravel() / HELD_SIGMA**2, at), shape=(size, size))
