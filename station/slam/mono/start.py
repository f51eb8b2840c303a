"""The first pictures once more, all together: the same model, linearised where it ends instead of where it began.

While little has moved, a picture's motion is inverse depth times velocity, both unknown, and a filter that fixes its
derivatives at the first guess settles on a wrong pair too surely, or on the mirrored one. So the first pictures'
measurements are kept, and a few times the most probable state is sought from all of them (Gauss-Newton, damped).

The unknowns u are what eqs. 2.2 and C.2 take as noise: the impulses of each picture, and of each feature the error of
its first pixel and its inverse depth. They are independent; all else is `move`, `first_seen` and `predict` in a chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse

from shared.geometry import FloatArray, IntArray
from station.slam.mono.config import FilterConfig
from station.slam.mono.measurement import first_seen, predict
from station.slam.mono.motion import CAMERA, POSE, first_camera, impulse_covariance, move
from station.slam.mono.state import State
from station.vision.lens import Lens

STEPS = 40
SETTLED = 1e-2  # of the cost, a chi-square
BAD_SIGMAS = 2.0  # a feature whose errors are larger on the mean is no fixed point
OUT_OF_VIEW = 100.0  # sigmas: what a step costs that takes a feature out of the picture that shows it
SWEEPS = 3  # with features left out and the noise measured
HUBER = 3.0  # sigmas; beyond, a measurement counts by its distance instead of its square


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The most probable first pictures."""

    cost: float
    u: FloatArray  # (6 K + 3 N,)
    cov: FloatArray
    x_v: FloatArray  # (K + 1, 13) cameras
    x_v_by_u: FloatArray  # (K + 1, 13, 6 K)
    y: FloatArray  # (N, 6) features
    y_by_u: FloatArray  # (N, 6, 6 K + 3 N)
    error_px: FloatArray  # (M, 2) of the measurements


class Start:
    def __init__(self, lens: Lens, config: FilterConfig) -> None:
        self._lens, self._config = lens, config
        self._dt_s: list[float] = []
        self._seen: list[tuple[IntArray, FloatArray]] = []

    def take(self, dt_s: float, state: State, ids: IntArray, uv_px: FloatArray, sigma_px: float) -> tuple[State, float]:
        """Keep a picture's measurements while the start lasts; the state and the noise, better where it was solved."""
        if len(self._seen) >= max(self._config.start_frames):
            return state, sigma_px
        self._dt_s.append(dt_s)
        self._seen.append((ids, uv_px))
        return self._solve(state) if len(self._seen) in self._config.start_frames else (state, sigma_px)

    def _solve(self, state: State) -> tuple[State, float]:
        counts = [len(ids) for ids, _ in self._seen]
        every = np.concatenate([ids for ids, _ in self._seen])
        frame, uv = np.repeat(np.arange(len(counts)), counts), np.concatenate([uv for _, uv in self._seen])
        keep, sigma_px = np.ones(len(every), dtype=bool), self._config.sigma_px
        for _ in range(SWEEPS):
            dt_s = np.array(self._dt_s[1:])
            problem = Problem(self._lens, self._config, dt_s, every[keep], frame[keep], uv[keep], sigma_px)
            ones = problem.solve(problem.mean)
            best = min(ones, problem.solve(problem.mirrored(ones.u)), key=lambda found: found.cost)
            sigma_px, bad = problem.judge(best)
            if not len(bad):
                break
            keep &= ~np.isin(every, bad)
        return problem.state(best, state), sigma_px


class Problem:
    """All that was measured, one row a feature and picture."""

    def __init__(
        self,
        lens: Lens,
        config: FilterConfig,
        dt_s: FloatArray,
        ids: IntArray,
        frame: IntArray,
        uv_px: FloatArray,
        sigma_px: float,
    ) -> None:
        self._lens, self._config, self._sigma_px = lens, config, sigma_px
        self.ids, first, feature = np.unique(ids, return_index=True, return_inverse=True)
        self._dt_s, self._first_uv, self._first = dt_s, uv_px[first], frame[first]
        later = frame > self._first[feature]
        self._frame, self._feature, self._uv = frame[later], feature[later], uv_px[later]
        K, N = len(dt_s), len(self.ids)
        self.K, self.N = K, N
        impulses = np.sqrt(np.array([np.diag(impulse_covariance(config, dt)) for dt in dt_s]))
        impulses[0] = np.hypot(impulses[0], np.sqrt(np.diag(first_camera(config)[1])[7:]))  # the first velocity too
        own = np.tile([sigma_px, sigma_px, config.sigma_first_inverse_depth], N)
        self.sigma = np.concatenate([impulses.ravel(), own])
        self.mean = np.zeros(len(self.sigma))
        self.mean[6 * K + 2 :: 3] = config.first_inverse_depth

    def mirrored(self, u: FloatArray) -> FloatArray:
        """The world that moves alike in the pictures: near and far exchanged, the camera on the other side, and turned.

        To first order a pixel moves by rho (-V_x, -V_y) + (-Omega_y, Omega_x), the same for 2 mean - rho, -V and
        Omega + 2 mean (-V_y, V_x): the reversal of a relief, which only a longer path tells from the truth.
        """
        other, K = u.copy(), self.K
        rho, impulse = other[6 * K + 2 :: 3], other[: 6 * K].reshape(K, 6)
        middle = float(np.median(rho))
        impulse[:, 3:5] += 2.0 * middle * impulse[:, 1::-1] * [-1.0, 1.0]
        impulse[:, :2] *= -1.0
        rho[:] = np.maximum(2.0 * middle - rho, 0.1 * middle)
        return other

    def solve(self, u: FloatArray) -> Solved:
        damping = 1e-3
        found, A, b = self.linearised(u)
        for _ in range(STEPS):
            step = scipy.linalg.solve(A + damping * np.diag(np.diag(A)), -b, assume_a="pos", check_finite=False)
            new, A_new, b_new = self.linearised(found.u + step)
            if new.cost >= found.cost:
                damping *= 10.0
                continue
            gained, damping = found.cost - new.cost, 0.1 * damping
            found, A, b = new, A_new, b_new
            if gained < SETTLED:
                break
        found.cov[:] = scipy.linalg.inv(A)
        return found

    def linearised(self, u: FloatArray) -> tuple[Solved, FloatArray, FloatArray]:
        """With Huber's cost, J^T J and J^T e."""
        K, N, first, f = self.K, self.N, self._first, self._feature
        x_v, D = np.zeros((K + 1, CAMERA)), np.zeros((K + 1, CAMERA, 6 * K))
        x_v[0, 3] = 1.0
        for k in range(K):
            own = slice(6 * k, 6 * k + 6)
            x_v[k + 1], F, G = move(x_v[k], u[own], float(self._dt_s[k]))
            D[k + 1] = F @ D[k]
            D[k + 1, :, own] += G
        own_of = u[6 * K :].reshape(N, 3)
        y, by_camera, by_own = first_seen(x_v[first], self._first_uv + own_of[:, :2], own_of[:, 2], self._lens)
        seen = predict(x_v[self._frame], y[f], np.ones(len(f), dtype=bool), self._lens)
        e = (seen.uv_px - self._uv) / self._sigma_px
        e[~seen.in_view] = OUT_OF_VIEW
        length = np.linalg.norm(e, axis=1)
        over = np.maximum(length / HUBER, 1.0)
        off = (u - self.mean) / self.sigma
        cost = float(np.where(over > 1.0, 2.0 * HUBER * length - HUBER**2, length**2).sum() + off @ off)
        weight = (1.0 / (self._sigma_px * np.sqrt(over)))[:, None, None]
        blocks = (
            weight * seen.by_pose,
            weight * seen.by_feature @ by_camera[f][:, :, :POSE],
            weight * seen.by_feature @ by_own[f],
        )
        columns = POSE * self._frame, POSE * first[f], POSE * (K + 1) + 3 * f
        M = len(f)
        J = scipy.sparse.csr_array((2 * M, POSE * (K + 1) + 3 * N))
        for block, column in zip(blocks, columns, strict=True):
            rows = np.broadcast_to((2 * np.arange(M))[:, None, None] + np.arange(2)[:, None], block.shape)
            at = np.broadcast_to(column[:, None, None] + np.arange(block.shape[2]), block.shape)
            J = J + scipy.sparse.csr_array((block.ravel(), (rows.ravel(), at.ravel())), shape=J.shape)
        chain = scipy.linalg.block_diag(D[:, :POSE].reshape(-1, 6 * K), np.eye(3 * N))
        A = chain.T @ (J.T @ J).toarray() @ chain + np.diag(self.sigma**-2.0)
        b = chain.T @ (J.T @ (e / np.sqrt(over)[:, None]).ravel()) + off / self.sigma
        y_by_u = np.concatenate([by_camera @ D[first], np.zeros((N, 6, 3 * N))], axis=2)
        for i in range(N):
            y_by_u[i, :, 6 * K + 3 * i : 6 * K + 3 * i + 3] = by_own[i]
        return Solved(cost, u, np.empty_like(A), x_v, D, y, y_by_u, e * self._sigma_px), A, b

    def judge(self, found: Solved) -> tuple[float, IntArray]:
        """The noise that is left, and the features that contradict the others."""
        square = (found.error_px**2).sum(axis=1)
        count = np.bincount(self._feature, minlength=self.N)
        mean = np.bincount(self._feature, square, minlength=self.N) / np.maximum(2 * count, 1)
        common = float(np.median(np.repeat(mean, count)))
        good = mean < 4.0 * common
        rows = good[self._feature]
        free = 2 * int(rows.sum()) - 6 * self.K - int(good.sum())
        sigma_px = max(float(np.sqrt(square[rows].sum() / max(free, 1))), self._config.min_sigma_px)
        return sigma_px, self.ids[mean > (BAD_SIGMAS * sigma_px) ** 2]

    def state(self, found: Solved, old: State) -> State:
        """The filter's state at the last picture, of the features of `old` that were not left out."""
        alive = np.flatnonzero(np.isin(self.ids, old.ids))
        x = np.concatenate([found.x_v[-1], found.y[alive].ravel()])
        J = np.zeros((len(x), len(found.u)))
        J[:CAMERA, : 6 * self.K] = found.x_v_by_u[-1]
        J[CAMERA:] = found.y_by_u[alive].reshape(-1, len(found.u))
        P = J @ found.cov @ J.T
        return State(x, 0.5 * (P + P.T), self.ids[alive], np.ones(len(alive), dtype=bool))
