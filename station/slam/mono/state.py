"""The state of the filter: the camera (12) and its features, six numbers or three each, with one covariance for all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from shared.geometry import FloatArray, IntArray, se3, so3_exp, so3_log
from station.slam.mono.config import FilterConfig
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

    def blocks(self) -> FloatArray:
        """S_ij (M, M, 2, 2); S_ii is S_i of eq. 2.6, a feature's own ellipse."""
        M = len(self.rows)
        return self.S.reshape(M, 2, M, 2).swapaxes(1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Mean and covariance. Features stand in the order in which they came."""

    x: FloatArray  # (n,) the camera's 12 numbers (motion.py), then those of the features
    R: FloatArray  # (3, 3) R^WR, the camera's attitude
    P: FloatArray  # (n, n)
    ids: IntArray  # (N,) of the features
    is_inverse: BoolArray  # (N,) six numbers (C.2) instead of three (C.1)

    @classmethod
    def first(cls, config: FilterConfig) -> State:
        x, P = first_camera(config)
        return cls(x, np.eye(3), P, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool))

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

    def moved(self, config: FilterConfig, dt_s: float) -> State:
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

        at: where the derivatives are taken, instead of here. Its features begin with those of this state, and all of
            both are of six numbers.
        """
        seen = (self if at is None else at).predict(lens)
        H_x, H_y, mine = seen.by_pose[rows], seen.by_feature[rows], self.rows()[rows]
        HP = (H_x @ self.P[:POSE] + H_y @ self.P[mine]).reshape(-1, len(self.x))
        # Eq. 2.6, its four terms: two in HP (P_xx and P_yx; P_xy and P_yy), by H_x and by H_y once more.
        S = HP[:, :POSE] @ H_x.reshape(-1, POSE).T + np.einsum("amk,mjk->amj", HP[:, mine], H_y).reshape(
            len(HP), len(HP)
        )
        own = np.tile(sigma_px**2 * np.eye(2), (len(rows), 1, 1))  # R of eq. 2.6
        uv = seen.uv_px[rows]
        if at is None:
            mean, more = self._product_moments(rows)
            J = seen.by_direction[rows]
            uv = uv + (J @ mean[:, :, None])[:, :, 0]
            own += J @ more @ np.swapaxes(J, 1, 2)
        else:
            off = self._minus(at)
            uv = uv + H_x @ off[:POSE] + (H_y @ off[mine][:, :, None])[:, :, 0]
        expected = Expected(rows, uv, HP, 0.5 * (S + S.T))
        M = range(len(rows))
        expected.blocks()[M, M] += own
        return expected

    def _product_moments(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """What mean (M, 3) and covariance (M, 3, 3) of rho (x_i - r) in eq. C.5 have beyond the derivatives' part.

        Derivatives know nothing of either factor's error times the other's, which at first is most of it: a feature
        of unknown depth seen from where it was first seen tells the linear filter a velocity, and far too surely.
        E[rho a] = rho a + C, Cov[rho a] = (what is linear) + P_rho P_a + C C^T with C = Cov(rho, a).
        """
        inverse, P, place = self.is_inverse[rows][:, None], self.P, self.rows()[rows][:, :3]
        rho = np.where(inverse, self.rows()[rows][:, 5:], 0)  # row 0 of an XYZ feature: left out at the end
        C = P[place, rho] - P[rho, np.arange(3)]
        crossed = P[place[:, :, None], np.arange(3)]
        P_a = P[place[:, :, None], place[:, None, :]] + P[POSITION, POSITION] - crossed - np.swapaxes(crossed, 1, 2)
        more = P[rho, rho][:, :, None] * P_a + C[:, :, None] * C[:, None, :]
        return np.where(inverse, C, 0.0), np.where(inverse[:, :, None], more, 0.0)

    def _minus(self, at: State) -> FloatArray:
        """This mean (n,) seen from another, whose state begins with the same numbers."""
        off = self.x - at.x[: len(self.x)]
        off[ATTITUDE] = so3_log(at.R.T @ self.R)
        return off

    def updated(self, expected: Expected, uv_px: FloatArray) -> State:
        """The Kalman update with measured pixels (M, 2): x + P H^T S^-1 nu, P - P H^T S^-1 H P."""
        L = np.linalg.cholesky(expected.S)
        nu = (uv_px - expected.uv_px).ravel()
        W = scipy.linalg.solve_triangular(L, expected.HP, lower=True, check_finite=False)
        x = self.x + W.T @ scipy.linalg.solve_triangular(L, nu, lower=True, check_finite=False)
        R = self.R @ so3_exp(x[ATTITUDE])
        x[ATTITUDE] = 0.0
        return replace(self, x=x, R=R, P=self.P - W.T @ W)

    # ---- the map

    def with_features(
        self, ids: IntArray, uv_px: FloatArray, lens: Lens, config: FilterConfig, sigma_px: float
    ) -> State:
        """New features of six numbers from one view of them (C.2): all that is unknown is how far they are."""
        if not len(ids):
            return self
        y, J, by_own = first_seen(self.x[POSITION], self.R, uv_px, config.first_inverse_depth, lens)  # eq. C.2
        own = by_own * np.array([sigma_px, sigma_px, config.sigma_first_inverse_depth]) ** 2 @ np.swapaxes(by_own, 1, 2)
        J = J.reshape(-1, POSE)
        with_state = J @ self.P[:POSE]
        among = with_state[:, :POSE] @ J.T + scipy.linalg.block_diag(*own)
        return replace(
            self,
            x=np.concatenate([self.x, y.ravel()]),
            P=np.block([[self.P, with_state.T], [with_state, among]]),
            ids=np.concatenate([self.ids, ids]),
            is_inverse=np.concatenate([self.is_inverse, np.ones(len(ids), dtype=bool)]),
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

    def without(self, leave: BoolArray) -> State:
        """Fewer features; leave (N,) says which go."""
        rows = self.rows()
        gone = np.append(rows[leave, :3], rows[leave & self.is_inverse, 3:])
        return replace(self, is_inverse=self.is_inverse[~leave])._keeping(self.ids[~leave], gone)

    def _keeping(self, ids: IntArray, gone: IntArray) -> State:
        """With these ids, and without these numbers of x."""
        keep = np.delete(np.arange(len(self.x)), gone)
        return replace(self, x=self.x[keep], P=self.P[np.ix_(keep, keep)], ids=ids)
