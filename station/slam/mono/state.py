"""The state of the filter: the camera (12) and its features, six numbers or three each, with one covariance for all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from shared.geometry import FloatArray, IntArray, se3, so3_exp, so3_log
from station.slam.mono.config import MonoConfig
from station.slam.mono.measurement import Predicted, first_seen, predict, to_xyz
from station.slam.mono.motion import ATTITUDE, CAMERA, POSE, POSITION, impulse_covariance, move
from station.vision.bearings import bearing
from station.vision.innovations import diagonal_blocks, whitened
from station.vision.lens import BoolArray, Lens


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where M features should be found in an image, and how surely, all together."""

    rows: IntArray  # (M,) of State.ids
    uv_px: FloatArray  # (M, 2)
    H: FloatArray  # (2M, 12) their derivatives by the camera's pose and the feature's own numbers
    columns: IntArray  # (2M, 12) where these stand in the state
    HP: FloatArray  # (2M, n) what links their pixels to every number of the state
    S: FloatArray  # (2M, 2M) of their innovations

    def of(self, chosen: IntArray) -> Expected:
        """The same of fewer features; chosen (K,) indexes rows."""
        two = (2 * chosen[:, None] + np.arange(2)).ravel()
        of_two = self.H[two], self.columns[two], self.HP[two], self.S[np.ix_(two, two)]
        return Expected(self.rows[chosen], self.uv_px[chosen], *of_two)

    def ellipses(self) -> FloatArray:
        """S_i of eq. 2.6 (M, 2, 2), each feature's own: the blocks on the diagonal."""
        return diagonal_blocks(self.S, 2)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Mean and covariance. Features stand in the order in which they came."""

    x: FloatArray  # (n,) the camera's 12 numbers (motion.py), then those of the features
    R: FloatArray  # (3, 3) R^WR, the camera's attitude
    P: FloatArray  # (n, n)
    ids: IntArray  # (N,) of the features
    is_inverse: BoolArray  # (N,) six numbers (C.2) instead of three (C.1)
    noise: FloatArray  # (N, 2, 2) covariance of its pixels, times sigma_px^2

    @classmethod
    def first(cls, config: MonoConfig) -> State:
        """At the first image, whose pose is the world: known, by definition."""
        P = np.diag(np.repeat([0.0, 0.0, config.sigma_first_velocity, config.sigma_first_turn], 3) ** 2)
        none = np.zeros(0, dtype=np.int64)
        return cls(np.zeros(CAMERA), np.eye(3), P, none, none > 0, np.zeros((0, 2, 2)))

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

    def points(self) -> FloatArray:
        """All features as points (N, 3), eq. C.3."""
        y, far = self.features(), self.is_inverse
        p = y[:, :3].copy()
        p[far] = to_xyz(y[far])[0]
        return p

    # ---- time

    def moved(self, config: MonoConfig, dt_s: float) -> tuple[State, FloatArray]:
        """After dt without an image: eqs. 2.1 to 2.3, and F (12, 12) of eq. 2.2. Features rest."""
        x, P = self.x.copy(), self.P.copy()
        x[:CAMERA], R, F, G = move(self.x[:CAMERA], self.R, np.zeros(6), dt_s)
        P[:CAMERA] = F @ P[:CAMERA]
        P[:, :CAMERA] = P[:, :CAMERA] @ F.T
        P[:CAMERA, :CAMERA] += G @ impulse_covariance(config, dt_s) @ G.T  # Q_v of eq. 2.3
        return replace(self, x=x, R=R, P=P), F

    # ---- images

    def predict(self, lens: Lens, rows: IntArray | None = None) -> Predicted:
        some = slice(None) if rows is None else rows
        return predict(self.x[POSITION], self.R, self.features()[some], self.is_inverse[some], lens)

    def in_view(self, lens: Lens, margin_px: float = 0.0) -> tuple[IntArray, FloatArray]:
        """Rows (K,) of the features that the camera should see, and their pixels (K, 2)."""
        seen = self.predict(lens)
        rows = np.flatnonzero(seen.is_ahead & lens.is_inside(seen.uv_px, margin_px))
        return rows, seen.uv_px[rows]

    def expect(
        self, lens: Lens, rows: IntArray, sigma_px: float, at: tuple[State, Predicted] | None = None
    ) -> Expected:
        """What an image should show of these features (M,), derivatives taken here, or at a state that sees them so."""
        seen = self.predict(lens, rows) if at is None else at[1]
        uv, H_x, H_y, mine = seen.uv_px, seen.by_pose, seen.by_feature, self.rows()[rows]
        columns = np.concatenate([np.broadcast_to(np.arange(POSE), (len(rows), POSE)), mine], axis=1)
        values, columns = np.concatenate([H_x, H_y], axis=2).reshape(-1, 12), np.repeat(columns, 2, axis=0)
        ends = np.arange(0, columns.size + 1, 12)
        H = csr_array((values.ravel(), columns.ravel(), ends), shape=(len(values), len(self.x)))
        HP = np.asarray(H @ self.P)
        S = np.asarray(H @ HP.T)  # eq. 2.6, its four terms: H has a part of the camera and one of the feature
        if at is not None:  # this mean, seen from there to first order
            there = at[0]
            pose = np.concatenate([self.x[POSITION] - there.x[POSITION], so3_log(there.R.T @ self.R)])
            feature = self.x[mine] - there.x[there.rows()[np.searchsorted(there.ids, self.ids[rows])]]
            uv = uv + H_x @ pose + (H_y @ feature[:, :, None])[:, :, 0]
        S = 0.5 * (S + S.T)
        diagonal_blocks(S, 2)[:] += sigma_px**2 * self.noise[rows]  # R of eq. 2.6
        return Expected(rows, uv, values, columns, HP, S)

    def updated(self, expected: Expected, uv_px: FloatArray) -> State:
        """The Kalman update with measured pixels (M, 2): x + P H^T S^-1 nu, P - P H^T S^-1 H P."""
        if not len(uv_px):
            return self
        return self.updated_by(*whitened(expected.S, expected.HP, uv_px - expected.uv_px)[1:])

    def updated_by(self, HP: FloatArray, nu: FloatArray) -> State:
        """The same with L^-1 H P and L^-1 nu."""
        return replace(self.shifted(HP.T @ nu), P=self.P - HP.T @ HP)

    def shifted(self, step: FloatArray) -> State:
        """The same, its mean so far (n,) away."""
        x = self.x + step
        R = self.R @ so3_exp(x[ATTITUDE])
        x[ATTITUDE] = 0.0
        return replace(self, x=x, R=R)

    # ---- the map

    def with_features(
        self, ids: IntArray, uv_px: FloatArray, noise: FloatArray, lens: Lens, config: MonoConfig, sigma_px: float
    ) -> State:
        """New features of six numbers from one view of them (C.2): all that is unknown is how far they are."""
        if not len(ids):
            return self
        y, J, by_own = first_seen(self.x[POSITION], self.R, uv_px, config.first_inverse_depth, lens)  # eq. C.2
        own = np.tile(np.diag([0.0, 0.0, config.sigma_first_inverse_depth**2]), (len(ids), 1, 1))
        own[:, :2, :2] = sigma_px**2 * noise
        J = J.reshape(-1, POSE)
        with_state = J @ self.P[:POSE]
        among = with_state[:, :POSE] @ J.T
        diagonal_blocks(among, 6)[:] += by_own @ own @ np.swapaxes(by_own, 1, 2)
        return replace(
            self,
            x=np.concatenate([self.x, y.ravel()]),
            P=np.block([[self.P, with_state.T], [with_state, among]]),
            ids=np.concatenate([self.ids, ids]),
            is_inverse=np.concatenate([self.is_inverse, np.ones(len(ids), dtype=bool)]),
            noise=np.concatenate([self.noise, noise]),
        )

    def linearity(self) -> FloatArray:
        """L_d (N,) of inverse-depth features, small where XYZ would do as well; infinity of XYZ features."""
        # Source: Civera, Davison and Montiel, IEEE T-RO 24(5), 2008, eq. 28: 4 sigma_d |cos alpha| / d
        y, row = self.features(), self.rows()[:, 5]
        rho, m = np.maximum(y[:, 5:], 1e-6), bearing(y[:, 3:5])
        away = y[:, :3] + m / rho - self.x[POSITION]
        sigma_d = np.sqrt(self.P[row, row]) / rho[:, 0] ** 2
        L_d = 4.0 * sigma_d * np.abs((m * away).sum(axis=1)) / np.maximum((away**2).sum(axis=1), 1e-18)
        return np.where(self.is_inverse, L_d, np.inf)

    def with_xyz(self, which: BoolArray) -> State:
        """These inverse-depth features (N,) as XYZ (eq. C.3)."""
        rows, (p, J) = self.rows()[which], to_xyz(self.features()[which])
        x, A = self.x.copy(), np.eye(len(self.x))
        x[rows[:, :3]] = p
        A[rows[:, :3, None], rows[:, None, :]] = J
        state = replace(self, x=x, P=A @ self.P @ A.T, is_inverse=self.is_inverse & ~which)
        return state._without_numbers(rows[:, 3:])

    def only(self, ids: IntArray) -> State:
        rows, stay = self.rows(), np.isin(self.ids, ids)
        gone = np.append(rows[~stay, :3], rows[~stay & self.is_inverse, 3:])
        state = replace(self, ids=self.ids[stay], is_inverse=self.is_inverse[stay], noise=self.noise[stay])
        return state._without_numbers(gone)

    def _without_numbers(self, gone: IntArray) -> State:
        keep = np.delete(np.arange(len(self.x)), gone)
        return replace(self, x=self.x[keep], P=self.P[np.ix_(keep, keep)])
