"""The state of the filter: the camera (13) and its features, six numbers or three each, with one covariance for all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from shared.geometry import FloatArray, IntArray
from station.slam.mono.config import FilterConfig
from station.slam.mono.measurement import Predicted, bearing, first_seen, to_xyz
from station.slam.mono.motion import ATTITUDE, CAMERA, POSE, POSITION, impulse_covariance, move
from station.slam.mono.quaternion import normalise
from station.vision.lens import BoolArray, Lens


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Mean and covariance. Features stand in the order in which they came."""

    x: FloatArray  # (n,)
    P: FloatArray  # (n, n)
    ids: IntArray  # (N,) of the features
    is_inverse: BoolArray  # (N,) six numbers (C.2) instead of three (C.1)

    @property
    def camera(self) -> FloatArray:
        return self.x[:CAMERA]

    def rows(self) -> IntArray:
        """(N, 6) where each feature's numbers stand in x; row 0 in place of the last three of an XYZ feature."""
        size = np.where(self.is_inverse, 6, 3)
        start = CAMERA + np.cumsum(size) - size
        rows = start[:, None] + np.arange(6)
        rows[~self.is_inverse, 3:] = 0
        return rows

    def features(self) -> FloatArray:
        """y (N, 6) of measurement.py."""
        y = self.x[self.rows()]
        y[~self.is_inverse, 3:] = 0.0
        return y

    def points(self) -> tuple[FloatArray, FloatArray]:
        """All features as points (N, 3), eq. C.3, with their covariances (N, 3, 3)."""
        y, rows, inverse = self.features(), self.rows(), self.is_inverse
        p, J = y[:, :3].copy(), np.zeros((len(y), 3, 6))
        J[:, range(3), range(3)] = 1.0
        p[inverse], J[inverse] = to_xyz(y[inverse])
        return p, J @ self.P[rows[:, :, None], rows[:, None, :]] @ np.swapaxes(J, 1, 2)

    # ---- time

    def moved(self, config: FilterConfig, dt_s: float) -> State:
        """After dt without an image: eqs. 2.1 to 2.3. Features rest."""
        camera, F, G = move(self.camera, np.zeros(6), dt_s)
        Q_v = G @ impulse_covariance(config, dt_s) @ G.T  # eq. 2.3
        P = self.P.copy()
        P[:CAMERA, CAMERA:] = F @ self.P[:CAMERA, CAMERA:]
        P[CAMERA:, :CAMERA] = P[:CAMERA, CAMERA:].T
        P[:CAMERA, :CAMERA] = F @ self.P[:CAMERA, :CAMERA] @ F.T + Q_v
        return self._with(np.concatenate([camera, self.x[CAMERA:]]), P)

    # ---- images

    def spread(self, seen: Predicted, chosen: IntArray) -> FloatArray:
        """H P (2M, n) of the chosen features: what links their pixels to every number of the state."""
        rows = self.rows()[chosen]
        by_feature = (seen.by_feature @ self.P[rows]).reshape(-1, len(self.x))
        return seen.by_pose.reshape(-1, POSE) @ self.P[:POSE] + by_feature

    def with_product_moments(self, seen: Predicted, chosen: IntArray) -> Predicted:
        """With the mean and the variance of rho (x_i - r) in eq. C.5 as those of a product of two Gaussians.

        Derivatives know nothing of either factor's error times the other's, which at first is most of it: a feature
        of unknown depth seen from where it was first seen tells the linear filter a velocity, and far too surely.
        E[rho a] = rho a + C, Cov[rho a] = (what is linear) + P_rho P_a + C C^T with C = Cov(rho, a).
        """
        i = np.flatnonzero(self.is_inverse[chosen])
        rows, P = self.rows()[chosen[i]], self.P
        origin, rho = rows[:, :3], rows[:, 5]
        C = P[origin, rho[:, None]] - P[POSITION, rho].T
        crossed = P[POSITION, origin].transpose(1, 0, 2)  # (M, 3, 3) of r and x_i
        P_a = P[origin[:, :, None], origin[:, None, :]] + P[POSITION, POSITION] - crossed - np.swapaxes(crossed, 1, 2)
        moment = P[rho, rho][:, None, None] * P_a + C[:, :, None] * C[:, None, :]
        J = seen.by_ray[i]
        uv, extra = seen.uv_px.copy(), seen.extra.copy()
        uv[i] += (J @ C[:, :, None])[:, :, 0]
        extra[i] = J @ moment @ np.swapaxes(J, 1, 2)
        return replace(seen, uv_px=uv, extra=extra)

    def innovation_covariance(self, seen: Predicted, chosen: IntArray, HP: FloatArray, sigma_px: float) -> FloatArray:
        """S (2M, 2M) of all chosen features together: eq. 2.6 in the 2x2 blocks along its diagonal."""
        rows, count = self.rows()[chosen], len(HP)
        by_feature = np.einsum("amk,mjk->amj", HP[:, rows], seen.by_feature).reshape(count, count)
        S = HP[:, :POSE] @ seen.by_pose.reshape(-1, POSE).T + by_feature
        return 0.5 * (S + S.T) + sigma_px**2 * np.eye(count) + scipy.linalg.block_diag(*seen.extra)

    def innovation_ellipses(self, seen: Predicted, chosen: IntArray, sigma_px: float) -> FloatArray:
        """S_i (M, 2, 2) of each chosen feature by itself: eq. 2.6, its four terms in order."""
        rows = self.rows()[chosen]
        H_x, H_y = seen.by_pose, seen.by_feature
        P_xx = self.P[:POSE, :POSE]
        P_xy = self.P[:POSE, rows].transpose(1, 0, 2)  # (M, 7, 6)
        P_yy = self.P[rows[:, :, None], rows[:, None, :]]
        crossed = H_x @ P_xy @ np.swapaxes(H_y, 1, 2)
        own = H_x @ P_xx @ np.swapaxes(H_x, 1, 2)
        return (
            own
            + crossed
            + np.swapaxes(crossed, 1, 2)
            + H_y @ P_yy @ np.swapaxes(H_y, 1, 2)
            + sigma_px**2 * np.eye(2)
            + seen.extra
        )

    def updated(self, HP: FloatArray, S: FloatArray, innovation: FloatArray) -> State:
        """The Kalman update: x + P H^T S^-1 nu, P - P H^T S^-1 H P, with the attitude made a unit quaternion again."""
        L = np.linalg.cholesky(S)
        W = scipy.linalg.solve_triangular(L, HP, lower=True, check_finite=False)
        x = self.x + W.T @ scipy.linalg.solve_triangular(L, innovation, lower=True, check_finite=False)
        P = self.P - W.T @ W
        x[ATTITUDE], J = normalise(x[ATTITUDE])
        P[ATTITUDE] = J @ P[ATTITUDE]
        P[:, ATTITUDE] = P[:, ATTITUDE] @ J.T
        return self._with(x, P)

    # ---- the map

    def with_features(
        self, ids: IntArray, uv_px: FloatArray, lens: Lens, config: FilterConfig, sigma_px: float
    ) -> State:
        """New features of six numbers from one view of them (C.2): all that is unknown is how far they are."""
        rho = np.full(len(ids), config.first_inverse_depth)
        y, by_camera, by_own = first_seen(np.tile(self.camera, (len(ids), 1)), uv_px, rho, lens)  # eq. C.2
        sigma = np.array([sigma_px, sigma_px, config.sigma_first_inverse_depth])
        own = by_own * sigma**2 @ np.swapaxes(by_own, 1, 2)
        J = by_camera.reshape(-1, CAMERA)
        with_state = J @ self.P[:CAMERA]
        among = with_state[:, :CAMERA] @ J.T + scipy.linalg.block_diag(*own)
        return State(
            np.concatenate([self.x, y.ravel()]),
            np.block([[self.P, with_state.T], [with_state, among]]),
            np.concatenate([self.ids, ids]),
            np.concatenate([self.is_inverse, np.ones(len(ids), dtype=bool)]),
        )

    def linearity(self) -> FloatArray:
        """L_d (N,) of inverse-depth features, small where XYZ would do as well; infinity of XYZ features.

        Source: Civera, Davison and Montiel, IEEE T-RO 24(5), 2008, eq. 28: 4 sigma_d |cos alpha| / d.
        """
        L_d = np.full(len(self.ids), np.inf)
        i = np.flatnonzero(self.is_inverse)
        y, row = self.features()[i], self.rows()[i, 5]
        rho = np.maximum(y[:, 5], 1e-6)
        m = bearing(y[:, 3:5])
        away = y[:, :3] + m / rho[:, None] - self.x[POSITION]
        d = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        sigma_d = np.sqrt(self.P[row, row]) / rho**2
        L_d[i] = 4.0 * sigma_d * np.abs((m * away).sum(axis=1)) / d**2
        return L_d

    def with_xyz(self, which: IntArray) -> State:
        """These inverse-depth features as XYZ (eq. C.3); which: rows of ids."""
        if not len(which):
            return self
        rows, points_J = self.rows()[which], to_xyz(self.features()[which])
        x, P, gone = self.x.copy(), self.P.copy(), []
        for six, p, J in zip(rows, *points_J, strict=True):
            three = six[:3]
            x[three] = p
            P[three] = J @ P[six]
            P[:, three] = P[:, six] @ J.T
            gone.append(six[3:])
        is_inverse = self.is_inverse.copy()
        is_inverse[which] = False
        return State(*_without(x, P, np.concatenate(gone)), self.ids, is_inverse)

    def without(self, leave: BoolArray) -> State:
        """Fewer features; leave (N,) says which go."""
        if not leave.any():
            return self
        rows, inverse = self.rows(), self.is_inverse
        gone = np.concatenate([rows[leave, :3].ravel(), rows[leave & inverse, 3:].ravel()])
        return State(*_without(self.x, self.P, gone), self.ids[~leave], inverse[~leave])

    def _with(self, x: FloatArray, P: FloatArray) -> State:
        return replace(self, x=x, P=P)


def _without(x: FloatArray, P: FloatArray, gone: IntArray) -> tuple[FloatArray, FloatArray]:
    keep = np.ones(len(x), dtype=bool)
    keep[gone] = False
    return x[keep], P[np.ix_(keep, keep)]
