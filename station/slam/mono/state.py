"""The state of the filter: the camera (12) and its features, six numbers or three each, with one covariance for all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from shared.geometry import FloatArray, IntArray, se3, so3_exp, so3_log
from station.slam.mono.config import MonoConfig
from station.slam.mono.measurement import Predicted, bearing, first_seen, predict, to_xyz
from station.slam.mono.motion import ATTITUDE, CAMERA, POSE, POSITION, first_camera, impulse_covariance, move
from station.vision.lens import BoolArray, Lens


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where M features should be found in an image, and how surely, all together."""

    rows: IntArray  # (M,) of State.ids
    uv_px: FloatArray  # (M, 2)
    HP: FloatArray  # (2M, n) what links their pixels to every number of the state
    S: FloatArray  # (2M, 2M) of their innovations

    def of(self, chosen: IntArray) -> Expected:
        """The same of fewer features; chosen (K,) indexes rows."""
        two = (2 * chosen[:, None] + np.arange(2)).ravel()
        return Expected(self.rows[chosen], self.uv_px[chosen], self.HP[two], self.S[np.ix_(two, two)])

    def ellipses(self) -> FloatArray:
        """S_i of eq. 2.6 (M, 2, 2), each feature's own: the blocks on the diagonal."""
        M = np.arange(len(self.rows))
        return self.S.reshape(len(M), 2, len(M), 2)[M, :, M]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Mean and covariance. Features stand in the order in which they came."""

    x: FloatArray  # (n,) the camera's 12 numbers (motion.py), then those of the features
    R: FloatArray  # (3, 3) R^WR, the camera's attitude
    P: FloatArray  # (n, n)
    ids: IntArray  # (N,) of the features
    is_inverse: BoolArray  # (N,) six numbers (C.2) instead of three (C.1)
    noise: FloatArray  # (N,) of how many sigma_px its pixels are measured

    @classmethod
    def first(cls, config: MonoConfig) -> State:
        x, P = first_camera(config)
        return cls(x, np.eye(3), P, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool), np.zeros(0))

    @property
    def T_world_cam(self) -> FloatArray:
        """(4, 4); the world of the filter is its first camera's."""
        return se3(self.R, self.x[POSITION])

    def rows(self) -> IntArray:
        """(N, 6) where each feature's numbers stand in x; row 0 in place of the last three of an XYZ feature."""
        size = np.where(self.is_inverse, 6, 3)
        start = CAMERA + np.cumsum(size) - size
        return np.where(self.is_inverse[:, None] | (np.arange(6) < 3), start[:, None] + np.arange(6), 0)

    def features(self) -> FloatArray:
        """y (N, 6) of measurement.py."""
        y = self.x[self.rows()]
        y[~self.is_inverse, 3:] = 0.0
        return y

    def points(self) -> tuple[FloatArray, FloatArray]:
        """All features as points (N, 3), eq. C.3, with their covariances (N, 3, 3)."""
        y, rows, inverse = self.features(), self.rows(), self.is_inverse
        p, J = y[:, :3].copy(), np.tile(np.eye(3, 6), (len(y), 1, 1))
        p[inverse], J[inverse] = to_xyz(y[inverse])
        return p, J @ self.P[rows[:, :, None], rows[:, None, :]] @ np.swapaxes(J, 1, 2)

    # ---- time

    def moved(self, config: MonoConfig, dt_s: float) -> State:
        """After dt without an image: eqs. 2.1 to 2.3. Features rest."""
        x, P = self.x.copy(), self.P.copy()
        x[:CAMERA], R, F, G = move(self.x[:CAMERA], self.R, np.zeros(6), dt_s)
        P[:CAMERA] = F @ P[:CAMERA]
        P[:, :CAMERA] = P[:, :CAMERA] @ F.T
        P[:CAMERA, :CAMERA] += G @ impulse_covariance(config, dt_s) @ G.T  # Q_v of eq. 2.3
        return replace(self, x=x, R=R, P=P)

    # ---- images

    def predict(self, lens: Lens) -> Predicted:
        return predict(self.x[POSITION], self.R, self.features(), self.is_inverse, lens)

    def expect(self, lens: Lens, rows: IntArray, sigma_px: float, at: State | None = None) -> Expected:
        """What an image should show of these features (M,).

        at: where the derivatives are taken, instead of here; it has these features as well.
        """
        there = rows if at is None else np.searchsorted(at.ids, self.ids[rows])
        seen = (self if at is None else at).predict(lens)
        uv, H_x, H_y, mine = seen.uv_px[there], seen.by_pose[there], seen.by_feature[there], self.rows()[rows]
        HP = (H_x @ self.P[:POSE] + H_y @ self.P[mine]).reshape(-1, len(self.x))
        # Eq. 2.6, its four terms: two in HP (P_xx and P_yx; P_xy and P_yy), by H_x and by H_y once more.
        by_feature = np.einsum("amk,mjk->amj", HP[:, mine], H_y).reshape(len(HP), len(HP))
        S = HP[:, :POSE] @ H_x.reshape(-1, POSE).T + by_feature
        if at is not None:  # this mean, seen from there to first order
            pose = np.concatenate([self.x[POSITION] - at.x[POSITION], so3_log(at.R.T @ self.R)])
            feature = self.x[mine] - at.x[at.rows()[there]]
            uv = uv + H_x @ pose + (H_y @ feature[:, :, None])[:, :, 0]
        R = np.repeat(sigma_px * self.noise[rows], 2) ** 2  # of eq. 2.6
        return Expected(rows, uv, HP, 0.5 * (S + S.T) + np.diag(R))

    def updated(self, expected: Expected, uv_px: FloatArray) -> State:
        """The Kalman update with measured pixels (M, 2): x + P H^T S^-1 nu, P - P H^T S^-1 H P."""
        if not len(uv_px):
            return self
        L = np.linalg.cholesky(expected.S)
        nu = (uv_px - expected.uv_px).ravel()
        W = scipy.linalg.solve_triangular(L, expected.HP, lower=True, check_finite=False)
        x = self.x + W.T @ scipy.linalg.solve_triangular(L, nu, lower=True, check_finite=False)
        R = self.R @ so3_exp(x[ATTITUDE])
        x[ATTITUDE] = 0.0
        return replace(self, x=x, R=R, P=self.P - W.T @ W)

    # ---- the map

    def with_features(
        self, ids: IntArray, uv_px: FloatArray, noise: FloatArray, lens: Lens, config: MonoConfig, sigma_px: float
    ) -> State:
        """New features of six numbers from one view of them (C.2): all that is unknown is how far they are."""
        if not len(ids):
            return self
        y, J, by_own = first_seen(self.x[POSITION], self.R, uv_px, config.first_inverse_depth, lens)  # eq. C.2
        sigma = np.insert(np.tile(sigma_px * noise, (2, 1)), 2, config.sigma_first_inverse_depth, axis=0).T  # (K, 3)
        own = by_own * sigma[:, None] ** 2 @ np.swapaxes(by_own, 1, 2)
        J = J.reshape(-1, POSE)
        with_state = J @ self.P[:POSE]
        among = with_state[:, :POSE] @ J.T + scipy.linalg.block_diag(*own)
        return replace(
            self,
            x=np.concatenate([self.x, y.ravel()]),
            P=np.block([[self.P, with_state.T], [with_state, among]]),
            ids=np.concatenate([self.ids, ids]),
            is_inverse=np.concatenate([self.is_inverse, np.ones(len(ids), dtype=bool)]),
            noise=np.concatenate([self.noise, noise]),
        )

    def linearity(self) -> FloatArray:
        """L_d (N,) of inverse-depth features, small where XYZ would do as well; infinity of XYZ features.

        Source: Civera, Davison and Montiel, IEEE T-RO 24(5), 2008, eq. 28: 4 sigma_d |cos alpha| / d.
        """
        y, row = self.features(), self.rows()[:, 5]
        rho, m = np.maximum(y[:, 5:], 1e-6), bearing(y[:, 3:5])
        away = y[:, :3] + m / rho - self.x[POSITION]
        sigma_d = np.sqrt(self.P[row, row]) / rho[:, 0] ** 2
        L_d = 4.0 * sigma_d * np.abs((m * away).sum(axis=1)) / np.maximum((away**2).sum(axis=1), 1e-18)
        return np.where(self.is_inverse, L_d, np.inf)

    def with_xyz(self, which: BoolArray) -> State:
        """These inverse-depth features (N,) as XYZ (eq. C.3)."""
        rows, (p, J) = self.rows()[which], to_xyz(self.features()[which])
        x, P = self.x.copy(), self.P.copy()
        x[rows[:, :3]] = p
        for six, by_six in zip(rows, J, strict=True):
            P[six[:3]] = by_six @ P[six]
            P[:, six[:3]] = P[:, six] @ by_six.T
        return replace(self, x=x, P=P, is_inverse=self.is_inverse & ~which)._keeping(self.ids, rows[:, 3:])

    def only(self, ids: IntArray) -> State:
        return self.without(~np.isin(self.ids, ids))

    def without(self, leave: BoolArray) -> State:
        """Fewer features; leave (N,) says which go."""
        rows = self.rows()
        gone = np.append(rows[leave, :3], rows[leave & self.is_inverse, 3:])
        return replace(self, is_inverse=self.is_inverse[~leave], noise=self.noise[~leave])._keeping(
            self.ids[~leave], gone
        )

    def _keeping(self, ids: IntArray, gone: IntArray) -> State:
        """With these ids, and without these numbers of x."""
        keep = np.delete(np.arange(len(self.x)), gone)
        return replace(self, x=self.x[keep], P=self.P[np.ix_(keep, keep)], ids=ids)
