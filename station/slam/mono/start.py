"""The first pictures once more, all together: the same model, linearised where it ends instead of where it began.

While little has moved, a picture's motion is inverse depth times velocity, both unknown, and a filter that fixes its
derivatives at the first guess settles on a wrong pair too surely, or on the mirrored one. So the measurements of the
first pictures are kept, and a few times the most probable path and map are sought by least squares (eqs. 2.1 to 2.6 and
C.2 to C.5, Levenberg-Marquardt, Huber's loss): once from what the filter believes, once from a camera that only turned
before features of equal depth, which lies between a world and its mirror image. The better one is the new state.

The unknowns are poses, but for the first, and of each feature its place in the picture and its inverse depth: by eq.
2.2 velocities are differences of poses. Turns are small and about the camera's own axes: R exp(turn).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse

from shared.geometry import FloatArray, IntArray, homogeneous, quat_from_rotation, skew, so3_exp, so3_log
from station.slam.mono.config import FilterConfig
from station.slam.mono.measurement import angles_of
from station.slam.mono.motion import ATTITUDE, CAMERA, POSITION, TURN, VELOCITY
from station.slam.mono.quaternion import left, rotation
from station.slam.mono.state import State
from station.vision.lens import Lens

STEPS = 60
SETTLED = 1e-3  # of the cost, a chi-square
HUBER = 3.0  # sigmas; beyond, a measurement counts by its distance instead of its square
NEAREST, WIDEST = 0.1, 2.0  # of a ray's z, and of normalised coordinates: a wild step stays finite
FIXED = -1  # column of what is not sought
# Residuals (M, d) with their derivatives: first columns (M,) of the unknowns, and blocks (M, d, k).
Terms = tuple[FloatArray, list[tuple[IntArray, FloatArray]]]


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """The unknowns, of K + 1 pictures and N features."""

    r: FloatArray  # (K + 1, 3) camera positions
    R: FloatArray  # (K + 1, 3, 3) attitudes
    xy: FloatArray  # (N, 2) where a feature's first picture shows it, normalised
    rho: FloatArray  # (N,) inverse distance from there

    def moved(self, dx: FloatArray) -> Guess:
        K = len(self.r) - 1
        pose, feature = dx[: 6 * K].reshape(K, 6), dx[6 * K :].reshape(-1, 3)
        r, R = self.r.copy(), self.R.copy()
        r[1:] += pose[:, :3]
        R[1:] = R[1:] @ so3_exp(pose[:, 3:])
        return Guess(r, R, self.xy + feature[:, :2], self.rho + feature[:, 2])

    def flat(self, rho: float) -> Guess:
        return Guess(np.zeros_like(self.r), self.R, self.xy, np.full_like(self.rho, rho))

    def pose_columns(self) -> IntArray:
        """(K + 1,)"""
        columns = 6 * np.arange(-1, len(self.r) - 1)
        columns[0] = FIXED
        return columns

    def feature_columns(self) -> IntArray:
        """(N,)"""
        return 6 * (len(self.r) - 1) + 3 * np.arange(len(self.rho))

    def rays(self) -> tuple[FloatArray, FloatArray]:
        """Unit rays (N, 3) in the axes of the first picture of each, and their derivative by xy (N, 3, 2)."""
        ray = homogeneous(self.xy)
        length = np.linalg.norm(ray, axis=1)[:, None]
        m = ray / length
        return m, ((np.eye(3) - m[:, :, None] * m[:, None, :]) / length[:, :, None])[:, :, :2]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """All that was measured, one row a feature and picture."""

    frame: IntArray  # (M,)
    feature: IntArray  # (M,)
    uv_px: FloatArray  # (M, 2)
    first_frame: IntArray  # (N,) of each feature
    dt_s: FloatArray  # (K,) between pictures


class Start:
    def __init__(self, lens: Lens, config: FilterConfig) -> None:
        self._lens, self._config = lens, config
        self._dt_s: list[float] = []
        self._cameras: list[FloatArray] = []
        self._seen: list[tuple[IntArray, FloatArray]] = []

    def take(self, dt_s: float, state: State, ids: IntArray, uv_px: FloatArray) -> State:
        """Keep a picture's measurements, as long as the start lasts; the state, a better one where it was solved."""
        if len(self._seen) >= max(self._config.start_frames):
            return state
        self._dt_s.append(dt_s)
        self._cameras.append(state.camera.copy())
        self._seen.append((ids, uv_px))
        return self._solve(state) if len(self._seen) in self._config.start_frames else state

    def _solve(self, state: State) -> State:
        counts = [len(ids) for ids, _ in self._seen]
        ids, first, feature = np.unique(
            np.concatenate([ids for ids, _ in self._seen]), return_index=True, return_inverse=True
        )
        frame, uv = np.repeat(np.arange(len(counts)), counts), np.concatenate([uv for _, uv in self._seen])
        measured = Measured(frame, feature, uv, frame[first], np.array(self._dt_s[1:]))
        cameras, y = np.array(self._cameras), state.features()
        rho = np.full(len(ids), self._config.first_inverse_depth)
        alive = np.searchsorted(ids, state.ids)
        away = np.linalg.norm(y[:, :3] - cameras[frame[first][alive], POSITION], axis=1)
        rho[alive] = np.where(state.is_inverse, y[:, 5], 1.0 / np.maximum(away, NEAREST))
        R = np.array([rotation(q) for q in cameras[:, ATTITUDE]])
        guess = Guess(cameras[:, POSITION], R, self._lens.unproject(uv[first]), rho)
        flat = guess.flat(self._config.first_inverse_depth)
        _, best, cov = min((self._descend(g, measured) for g in (guess, flat)), key=lambda found: found[0])
        return _state(best, cov, measured, state.ids, alive)

    def _descend(self, guess: Guess, measured: Measured) -> tuple[float, Guess, FloatArray]:
        """The cost of the nearest minimum, where it is, and the covariance of the unknowns there."""
        damping = 1e-3
        cost, A, b = self._normal_equations(guess, measured)
        for _ in range(STEPS):
            damped = A + damping * np.diag(np.diag(A))
            new = guess.moved(scipy.linalg.solve(damped, -b, assume_a="pos", check_finite=False))
            found = self._normal_equations(new, measured)
            if found[0] >= cost:
                damping *= 10.0
                continue
            gained, damping = cost - found[0], 0.1 * damping
            guess, (cost, A, b) = new, found
            if gained < SETTLED:
                break
        return cost, guess, np.asarray(scipy.linalg.inv(A))

    def _normal_equations(self, g: Guess, measured: Measured) -> tuple[float, FloatArray, FloatArray]:
        """Huber's cost, J^T J and J^T e."""
        pixels, *others = self.terms(g, measured)
        length = np.linalg.norm(pixels[0], axis=1)
        over = np.maximum(length / HUBER, 1.0)
        cost = float(np.where(over > 1.0, 2.0 * HUBER * length - HUBER**2, length**2).sum())
        cost += float(sum((e * e).sum() for e, _ in others))
        weight = 1.0 / np.sqrt(over)
        weighed = pixels[0] * weight[:, None], [(at, J * weight[:, None, None]) for at, J in pixels[1]]
        e, J = assembled((weighed, *others), 6 * (len(g.r) - 1) + 3 * len(g.rho))
        return cost, np.asarray((J.T @ J).toarray()), np.asarray(J.T @ e)

    def terms(self, g: Guess, measured: Measured) -> tuple[Terms, ...]:
        """All residuals, each over its sigma; pixels first."""
        return self._pixels(g, measured), *self._impulses(g, measured), self._depths(g)

    def _pixels(self, g: Guess, measured: Measured) -> Terms:
        """Eqs. C.5 and 2.5 with the lens' distortion, over sigma_px."""
        j, f = measured.frame, measured.feature
        a = measured.first_frame[f]
        m, m_by_xy = g.rays()
        R_jw = np.swapaxes(g.R[j], 1, 2)
        R_ja, between = R_jw @ g.R[a], (R_jw @ (g.r[a] - g.r[j])[:, :, None])
        h = (R_ja @ m[f][:, :, None] + g.rho[f, None, None] * between)[:, :, 0]
        z = np.maximum(h[:, 2], NEAREST)
        xy = np.clip(h[:, :2] / z[:, None], -WIDEST, WIDEST)
        pinhole = np.zeros((len(h), 2, 3))
        pinhole[:, 0, 0] = pinhole[:, 1, 1] = 1.0 / z
        pinhole[:, :, 2] = -xy / z[:, None]
        by_h = self._lens.whitening(xy, self._config.sigma_px) @ pinhole
        e = (self._lens.project(xy) - measured.uv_px) / self._config.sigma_px
        rho_R, columns = g.rho[f, None, None] * R_jw, np.where((j != a)[:, None], g.pose_columns()[[j, a]].T, FIXED)
        return e, [
            (columns[:, 0], by_h @ np.concatenate([-rho_R, skew(h)], axis=2)),
            (columns[:, 1], by_h @ np.concatenate([rho_R, -R_ja @ skew(m[f])], axis=2)),
            (g.feature_columns()[f], by_h @ np.concatenate([R_ja @ m_by_xy[f], between], axis=2)),
        ]

    def _impulses(self, g: Guess, measured: Measured) -> tuple[Terms, Terms]:
        """Eq. 2.1, V and Omega over their sigmas: what changes a velocity from one picture to the next.

        The first one holds the first velocity as well, of which only the size is known.
        """
        config, dt = self._config, measured.dt_s[:, None]
        phi = so3_log(np.swapaxes(g.R[:-1], 1, 2) @ g.R[1:])
        eye, half = np.broadcast_to(np.eye(3), (len(dt), 3, 3)) / dt[:, :, None], 0.5 * skew(phi) / dt[:, :, None]
        columns = np.concatenate([[FIXED], g.pose_columns()])
        none = np.zeros((1, 3, 3))

        def terms(velocity: FloatArray, new: FloatArray, old: FloatArray, first: float, accel: float, at: int) -> Terms:
            sigma = accel * dt
            sigma[0] = np.hypot(first, sigma[0])
            blocks = new, old - np.concatenate([none, new[:-1]]), np.concatenate([none, -old[:-1]])
            starts = columns[2:], columns[1:-1], columns[:-2]
            return np.diff(velocity, axis=0, prepend=0.0) / sigma, [
                (np.where(start >= 0, start + at, FIXED), block / sigma[:, :, None])
                for start, block in zip(starts, blocks, strict=True)
            ]

        v = np.diff(g.r, axis=0) / dt
        return (
            terms(v, eye, -eye, config.sigma_first_velocity, config.sigma_accel, 0),
            terms(phi / dt, eye + half, half - eye, config.sigma_first_turn, config.sigma_angular_accel, 3),
        )

    def _depths(self, g: Guess) -> Terms:
        """What is believed of an inverse depth before it is seen twice."""
        sigma = self._config.sigma_first_inverse_depth
        e = (g.rho[:, None] - self._config.first_inverse_depth) / sigma
        return e, [(g.feature_columns() + 2, np.full((len(e), 1, 1), 1.0 / sigma))]


def assembled(terms: tuple[Terms, ...], size: int) -> tuple[FloatArray, scipy.sparse.csr_array]:
    """All residuals in one column, and their derivative by all unknowns."""
    values, rows, columns, offset = [], [], [], 0
    for e, blocks in terms:
        row = offset + np.arange(e.size).reshape(*e.shape, 1)
        offset += e.size
        for start, J in blocks:
            sought = start != FIXED
            shape = J[sought].shape
            values.append(J[sought].ravel())
            rows.append(np.broadcast_to(row[sought], shape).ravel())
            columns.append(np.broadcast_to(start[sought, None, None] + np.arange(shape[2]), shape).ravel())
    at = np.concatenate(rows), np.concatenate(columns)
    J_all = scipy.sparse.csr_array((np.concatenate(values), at), shape=(offset, size))
    return np.concatenate([e.ravel() for e, _ in terms]), J_all


def _state(g: Guess, cov: FloatArray, measured: Measured, ids: IntArray, alive: IntArray) -> State:
    """The filter's state at the last picture; alive: rows of the features that it holds."""
    K, size, dt = len(g.r) - 1, CAMERA + 6 * len(ids), float(measured.dt_s[-1])
    x, J = np.zeros(size), np.zeros((size, len(cov)))
    q, phi = quat_from_rotation(g.R[-1]), so3_log(g.R[-2].T @ g.R[-1])
    x[:CAMERA] = np.concatenate([g.r[-1], q, (g.r[-1] - g.r[-2]) / dt, phi / dt])
    r, turn = slice(6 * K - 6, 6 * K - 3), slice(6 * K - 3, 6 * K)
    r_before, turn_before = slice(6 * K - 12, 6 * K - 9), slice(6 * K - 9, 6 * K - 6)
    J[POSITION, r] = np.eye(3)
    J[ATTITUDE, turn] = 0.5 * left(q)[:, 1:]
    J[VELOCITY, r], J[VELOCITY, r_before] = np.eye(3) / dt, -np.eye(3) / dt
    J[TURN, turn], J[TURN, turn_before] = (np.eye(3) + 0.5 * skew(phi)) / dt, (0.5 * skew(phi) - np.eye(3)) / dt
    m, m_by_xy = g.rays()
    for row, f in zip(range(CAMERA, size, 6), alive.tolist(), strict=True):
        a, column = int(measured.first_frame[f]), 6 * K + 3 * f
        angles, by_ray = angles_of((g.R[a] @ m[f])[None])
        by_axes = by_ray[0] @ g.R[a]
        x[row : row + 6] = np.concatenate([g.r[a], angles[0], g.rho[f : f + 1]])  # eq. C.2
        if a:
            J[row : row + 3, 6 * a - 6 : 6 * a - 3] = np.eye(3)
            J[row + 3 : row + 5, 6 * a - 3 : 6 * a] = -by_axes @ skew(m[f])
        J[row + 3 : row + 5, column : column + 2] = by_axes @ m_by_xy[f]
        J[row + 5, column + 2] = 1.0
    P = J @ cov @ J.T
    return State(x, 0.5 * (P + P.T), ids, np.ones(len(ids), dtype=bool))
