"""Bundle adjustment of a window with the IMU: poses, velocities and biases (docs/slam.md, sec. 7; thesis 2.10-2.13).

Unknown per pose: (phi, v, x, b_omega, b_a) with R = exp(phi) R_mean and the rest added; preintegrated readings link the
poses. Points are solved for given the poses in every iteration and projected out of the Jacobian (variable projection),
so that only poses remain: dense, for windows of some twenty poses, with their joint covariance. odometry_bundle.py
adjusts whole navigations of hundreds of keyframes and their landmarks, with relative motions in place of readings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from shared.calibration import ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray, skew, so3_exp, so3_log
from station.motion import lie
from station.motion.error_coordinates import ErrorKind, pose_jacobian
from station.motion.preintegration import Preintegration
from station.slam.mapping.rolling_shutter import observation_pose
from station.vision.camera_model import CameraModel, normalised_points
from station.vision.klt import TrackedFrame
from station.vision.lens import BoolArray
from station.vision.triangulation import Triangulation, triangulate

N = 15  # unknowns per pose


@dataclass(frozen=True, slots=True, eq=False)
class WindowTracks:
    """Tracks over the K frames of a window."""

    ids: IntArray  # (F,)
    uv_px: FloatArray  # (F, K, 2)
    xy: FloatArray  # (F, K, 2)
    seen: BoolArray  # (F, K)


def collect_tracks(frames: list[TrackedFrame], min_views: int) -> WindowTracks:
    """Tracks that at least min_views of the frames saw."""
    ids = np.unique(np.concatenate([f.ids for f in frames]))
    F, K = len(ids), len(frames)
    uv, xy, seen = np.zeros((F, K, 2)), np.zeros((F, K, 2)), np.zeros((F, K), dtype=bool)
    for k, frame in enumerate(frames):
        row = np.searchsorted(ids, frame.ids)
        uv[row, k], xy[row, k], seen[row, k] = frame.uv_px, frame.xy, True
    keep = seen.sum(axis=1) >= min_views
    return WindowTracks(ids[keep], uv[keep], xy[keep], seen[keep])


@dataclass(frozen=True, slots=True, eq=False)
class WindowStates:
    R: FloatArray  # (K, 3, 3)
    v: FloatArray  # (K, 3)
    x: FloatArray  # (K, 3)
    bias: FloatArray  # (K, 6) gyro, accel
    omega: FloatArray  # (K, 3) rad/s body, for rolling shutter only

    def moved(self, dx: FloatArray) -> WindowStates:
        d = dx.reshape(-1, N)
        return replace(
            self,
            R=so3_exp(d[:, :3]) @ self.R,
            v=self.v + d[:, 3:6],
            x=self.x + d[:, 6:9],
            bias=self.bias + d[:, 9:],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known beforehand; the first pose's position and yaw fix the frame."""

    bias_gyro: FloatArray  # (3,)
    bias_accel: FloatArray  # (3,)
    sigma_bias_gyro: float
    sigma_bias_accel: float
    sigma_frame: float = 1e-4  # rad and m
    v_first: FloatArray | None = None  # (3,) world
    sigma_v: float = 1.0
    R_first: FloatArray | None = None  # (3, 3) rotation that the first pose is known to have
    sigma_phi: float = 1.0
    v_body: FloatArray | None = None  # (K, 3) m/s, from wheels
    sigma_v_body: FloatArray | None = None  # (K, 3), infinite where unknown


@dataclass(frozen=True, slots=True, eq=False)
class WindowSolution:
    states: WindowStates
    factor: FloatArray  # (15 K, 15 K) lower-triangular Cholesky factor of the information matrix
    points: Triangulation
    used: BoolArray  # (F, K) observations that count
    rms: float  # whitened reprojection error of those
    has_converged: bool

    @property
    def covariance(self) -> FloatArray:
        """(15 K, 15 K) of all poses."""
        whole = cho_solve((self.factor, True), np.eye(len(self.factor)), check_finite=False)
        return np.asarray(0.5 * (whole + whole.T))

    def covariance_of(self, pose: int) -> FloatArray:
        """(15, 15) of one pose, for a fraction of the time."""
        at = slice(N * pose, N * pose + N)
        return np.asarray(cho_solve((self.factor, True), np.eye(len(self.factor))[:, at], check_finite=False)[at])


def solve_window(
    camera: CameraModel,
    noise: ImuNoise,
    gravity: float,
    states: WindowStates,
    links: list[Preintegration],
    tracks: WindowTracks,
    prior: Prior,
    iterations: int = 8,
    huber: float = 2.0,
) -> WindowSolution:
    """Most likely poses, velocities, biases given K - 1 IMU links and tracks.

    Raises:
        DegenerateGeometry: fewer than 8 usable tracks, or the normal equations are singular.
    """
    K = len(states.x)
    damping, cost, has_converged = 1e-6, np.inf, False
    best = states
    step = np.zeros(N * K)
    stacked = WindowLinks.of(links)
    for _ in range(iterations):
        trial = best.moved(step)
        H, g, trial_cost, rows = normal_equations(camera, noise, gravity, trial, stacked, tracks, prior, huber)
        if trial_cost <= cost * (1.0 + 1e-9):
            has_converged = cost - trial_cost < 3e-3 * max(1.0, trial_cost)
            best, cost, kept = trial, trial_cost, (H, g, rows)
            damping = max(damping * 0.1, 1e-9)
            if has_converged:
                break
        else:
            if trial_cost < cost * 1.003:  # the points' iteration leaves that much noise
                has_converged = True
                break
            damping = max(damping * 30.0, 1e-4)
        H, g = kept[0].copy(), kept[1]
        H[np.diag_indices_from(H)] *= 1.0 + damping
        try:
            step = cho_solve(cho_factor(H, lower=True, check_finite=False), g, check_finite=False)
        except np.linalg.LinAlgError as exc:
            raise DegenerateGeometry("the window's motion leaves its poses open") from exc
        size = float(np.abs(step).max())
        if not np.isfinite(size):
            raise DegenerateGeometry("the window's equations are singular")
    H, _, rows = kept
    try:
        factor, _ = cho_factor(H, lower=True, check_finite=False)
    except np.linalg.LinAlgError as exc:
        raise DegenerateGeometry("the window's motion leaves its poses open") from exc
    return WindowSolution(best, factor, rows.points, rows.used, rows.rms, has_converged)


def normal_equations(
    camera: CameraModel,
    noise: ImuNoise,
    gravity: float,
    states: WindowStates,
    links: WindowLinks,
    tracks: WindowTracks,
    prior: Prior,
    huber: float,
) -> tuple[FloatArray, FloatArray, float, VisualRows]:
    """H (15 K, 15 K), g = J^T r (to be solved as H dx = g), robust cost, reprojections."""
    K = len(states.x)
    H, g = np.zeros((N * K, N * K)), np.zeros(N * K)
    cost = _add_prior(H, g, states, prior)
    cost += _add_links(H, g, states, links, noise, gravity)
    rows = visual_rows(camera, states, tracks, huber)
    _add_tracks(H, g, rows)
    return H, g, cost + rows.cost, rows


@dataclass(frozen=True, slots=True, eq=False)
class WindowLinks:
    """All of the window's preintegrated motions, stacked."""

    duration_s: FloatArray  # (K - 1,)
    dR: FloatArray  # (K - 1, 3, 3)
    dv: FloatArray  # (K - 1, 3)
    dp: FloatArray  # (K - 1, 3)
    dR_by_bias: FloatArray  # (K - 1, 3, 3)
    dv_by_bias: FloatArray  # (K - 1, 3, 6)
    dp_by_bias: FloatArray  # (K - 1, 3, 6)
    bias: FloatArray  # (K - 1, 6)
    sqrt_information: FloatArray  # (K - 1, 9, 9)

    @classmethod
    def of(cls, links: list[Preintegration]) -> WindowLinks:
        return cls(
            duration_s=np.array([link.duration_s for link in links]),
            dR=np.array([link.dR for link in links]),
            dv=np.array([link.dv for link in links]),
            dp=np.array([link.dp for link in links]),
            dR_by_bias=np.array([link.dR_by_bias for link in links]),
            dv_by_bias=np.array([link.dv_by_bias for link in links]),
            dp_by_bias=np.array([link.dp_by_bias for link in links]),
            bias=np.array([link.bias for link in links]),
            sqrt_information=np.array([link.sqrt_information for link in links]),
        )


def _add_links(
    H: FloatArray, g: FloatArray, states: WindowStates, links: WindowLinks, noise: ImuNoise, gravity: float
) -> float:
    """The IMU between neighbouring poses, and how far biases walk meanwhile."""
    r, J = inertial_residuals(states, links, gravity)
    r = (links.sqrt_information @ r[..., None])[..., 0]
    J = links.sqrt_information @ J
    JtJ, Jtr = np.swapaxes(J, 1, 2) @ J, (np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
    sigma = np.repeat([noise.gyro_walk, noise.accel_walk], 3) * np.sqrt(links.duration_s)[:, None]
    d = np.diff(states.bias, axis=0) / sigma
    w = 1.0 / sigma**2
    own, next_ = np.arange(9, N), np.arange(N + 9, 2 * N)
    JtJ[:, own, own] += w
    JtJ[:, next_, next_] += w
    JtJ[:, own, next_] -= w
    JtJ[:, next_, own] -= w
    Jtr[:, own] -= d / sigma
    Jtr[:, next_] += d / sigma
    for i in range(len(r)):
        at = slice(N * i, N * i + 2 * N)
        H[at, at] += JtJ[i]
        g[at] -= Jtr[i]
    return float((r * r).sum() + (d * d).sum())


def inertial_residuals(states: WindowStates, links: WindowLinks, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Thesis eq. 2.11 (K - 1, 9) and its derivative (K - 1, 9, 30) by both poses of each link."""
    d = states.bias[:-1] - links.bias
    dR = links.dR @ so3_exp((links.dR_by_bias @ d[:, :3, None])[..., 0])
    dv = links.dv + (links.dv_by_bias @ d[..., None])[..., 0]
    dp = links.dp + (links.dp_by_bias @ d[..., None])[..., 0]
    Rit, Rj = np.swapaxes(states.R[:-1], 1, 2), states.R[1:]
    T = links.duration_s[:, None]
    fall = np.array([0.0, 0.0, -gravity])
    w_v = states.v[1:] - states.v[:-1] - fall * T
    w_x = states.x[1:] - states.x[:-1] - states.v[:-1] * T - 0.5 * fall * T * T
    r = np.empty((len(T), 9))
    r[:, :3] = so3_log(np.swapaxes(dR, 1, 2) @ Rit @ Rj)
    r[:, 3:6] = (Rit @ w_v[..., None])[..., 0] - dv
    r[:, 6:] = (Rit @ w_x[..., None])[..., 0] - dp
    J = np.zeros((len(T), 9, 2 * N))
    J[:, :3, :3] = -lie.so3_left_jacobian_inverse(-r[:, :3]) @ np.swapaxes(Rj, 1, 2)
    J[:, :3, N : N + 3] = -J[:, :3, :3]
    J[:, :3, 9:12] = -lie.so3_left_jacobian_inverse(r[:, :3]) @ links.dR_by_bias
    J[:, 3:6, :3] = Rit @ skew(w_v)
    J[:, 3:6, 3:6] = -Rit
    J[:, 3:6, N + 3 : N + 6] = Rit
    J[:, 3:6, 9:15] = -links.dv_by_bias
    J[:, 6:, :3] = Rit @ skew(w_x)
    J[:, 6:, 3:6] = -T[..., None] * Rit
    J[:, 6:, 6:9] = -Rit
    J[:, 6:, N + 6 : N + 9] = Rit
    J[:, 6:, 9:15] = -links.dp_by_bias
    return r, J


def _add_prior(H: FloatArray, g: FloatArray, states: WindowStates, prior: Prior) -> float:
    """Bias priors on the first pose, and the frame: its position and yaw stay where they are."""
    sigma = np.repeat([prior.sigma_bias_gyro, prior.sigma_bias_accel], 3)
    r = (np.concatenate([prior.bias_gyro, prior.bias_accel]) - states.bias[0]) / sigma
    at = np.arange(9, 15)
    H[at, at] += 1.0 / sigma**2
    g[at] += r / sigma
    cost = float(r @ r)
    held = np.array([2, 6, 7, 8])
    H[held, held] += 1.0 / prior.sigma_frame**2
    if prior.v_first is not None:
        r = (prior.v_first - states.v[0]) / prior.sigma_v
        at = np.arange(3, 6)
        H[at, at] += 1.0 / prior.sigma_v**2
        g[at] += r / prior.sigma_v
        cost += float(r @ r)
    if prior.R_first is not None:
        r = so3_log(prior.R_first @ states.R[0].T) / prior.sigma_phi
        at = np.arange(3)
        H[at, at] += 1.0 / prior.sigma_phi**2
        g[at] += r / prior.sigma_phi
        cost += float(r @ r)
    if prior.v_body is not None and prior.sigma_v_body is not None:
        cost += _add_wheels(H, g, states, prior.v_body, prior.sigma_v_body)
    return cost


def _add_wheels(H: FloatArray, g: FloatArray, states: WindowStates, v_body: FloatArray, sigma: FloatArray) -> float:
    """Body velocities R^T v that wheels know, Huber-weighted: they may slip."""
    cost = 0.0
    for k in range(len(states.x)):
        known = np.isfinite(sigma[k])
        Rt = states.R[k].T
        r = ((v_body[k] - Rt @ states.v[k]) / sigma[k])[known]
        J = np.hstack([Rt @ skew(states.v[k]), Rt])[known] / sigma[k][known, None]
        size = np.abs(r)
        w = np.minimum(1.0, 2.0 / np.maximum(size, 1e-9))
        at = slice(N * k, N * k + 6)
        H[at, at] += (J * w[:, None]).T @ J
        g[at] += (J * w[:, None]).T @ r
        cost += float(np.where(size < 2.0, size**2, 4.0 * size - 4.0).sum())
    return cost


@dataclass(frozen=True, slots=True, eq=False)
class VisualRows:
    """Reprojections of the points that given poses have, weighted, with their derivatives by the poses."""

    R: FloatArray  # (F, K, 3, 3) body pose at the time of each observation's row
    x: FloatArray  # (F, K, 3)
    p: FloatArray  # (F, K, 3) each point, once per pose
    predicted: FloatArray  # (F, K, 2) its normalised coordinates
    whitening: FloatArray  # (F, K, 2, 2) normalised coordinates to sigmas, times the robust weight
    by_point: FloatArray  # (F, K, 2, 3) of the predicted, whitened; by the point in the body frame
    by_pose: FloatArray  # (F, K, 2, 6) the same by rotation and position of the pose
    residual: FloatArray  # (F, K, 2)
    Qt: FloatArray  # (F, 3, 2 K) transposed basis of what moving the point explains
    cost: float  # robust
    points: Triangulation
    used: BoolArray  # (F, K)
    rms: float  # whitened

    def by_pose_explained(self) -> FloatArray:
        """(3 F, 6 K): what of the derivative by the poses moving the points explains."""
        F, K = self.used.shape
        QA = np.swapaxes(self.Qt.reshape(F, 3, K, 2), 1, 2) @ self.by_pose  # (F, K, 3, 6)
        return np.ascontiguousarray(np.swapaxes(QA, 1, 2)).reshape(3 * F, 6 * K)


def visual_rows(camera: CameraModel, states: WindowStates, tracks: WindowTracks, huber: float) -> VisualRows:
    """Linearise the reprojections. Raises DegenerateGeometry: fewer than 8 tracks can be triangulated."""
    uv_px, xy, seen = tracks.uv_px, tracks.xy, tracks.seen
    F, K = seen.shape
    if camera.line_delay_s:
        R, x = observation_pose(
            states.R, states.x, states.v, states.omega, camera.row_delay_s(uv_px[..., 1])
        )  # fmt: skip
    else:
        R, x = np.broadcast_to(states.R, (F, K, 3, 3)), np.broadcast_to(states.x, (F, K, 3))
    points = triangulate(camera, R, x, xy, seen, 4)
    good = points.is_good & (points.rms < 10.0)
    if good.sum() < 8:
        raise DegenerateGeometry("fewer than 8 tracks can be triangulated over the window")
    used = seen & good[:, None]
    p = np.where(good[:, None], points.p, 0.0)
    spread = np.broadcast_to(p[:, None], (F, K, 3))
    predicted, D, in_front = normalised_points(camera, R, x, spread)
    used = used & in_front
    W = camera.lens.whitening(xy, camera.sigma_px)
    r = (W @ (xy - predicted)[..., None])[..., 0] * used[..., None]
    size = np.linalg.norm(r, axis=-1)
    weight = np.sqrt(np.minimum(1.0, huber / np.maximum(size, 1e-9))) * used
    WD = W @ D * weight[..., None, None]
    J_p = (WD @ np.swapaxes(R, 2, 3)).reshape(F, 2 * K, 3)
    scale = np.maximum(np.linalg.norm(J_p, axis=1, keepdims=True), 1e-12)
    return VisualRows(
        R=R,
        x=x,
        p=spread,
        predicted=predicted,
        whitening=W * weight[..., None, None],
        by_point=WD,
        by_pose=WD @ pose_jacobian(ErrorKind.PLAIN, R, x, spread),
        residual=r * weight[..., None],
        Qt=np.swapaxes(np.linalg.qr(J_p / scale)[0], 1, 2),
        cost=float(np.where(size < huber, size**2, 2.0 * huber * size - huber**2).sum()),
        points=points,
        used=used,
        rms=float(np.sqrt((size[used] ** 2).mean() / 2.0)) if used.any() else np.inf,
    )


def visual_index(num_poses: int) -> IntArray:
    """(6 K,) which of the window's unknowns reprojections depend on: rotations and positions."""
    return np.asarray((np.arange(num_poses)[:, None] * N + np.array([0, 1, 2, 6, 7, 8])[None]).ravel())


def _add_tracks(H: FloatArray, g: FloatArray, rows: VisualRows) -> None:
    """Reprojections without their points: H = sum_f A^T (I - Q Q^T) A, with A block-diagonal over the poses."""
    F, K = rows.used.shape
    by_pose = np.ascontiguousarray(np.swapaxes(rows.by_pose, 0, 1)).reshape(K, 2 * F, 6)
    QA = rows.by_pose_explained()
    Qr = (rows.Qt @ rows.residual.reshape(F, 2 * K, 1)).reshape(3 * F)
    full = -(QA.T @ QA)
    diagonal = np.swapaxes(by_pose, 1, 2) @ by_pose
    for k in range(K):
        at = slice(6 * k, 6 * k + 6)
        full[at, at] += diagonal[k]
    r_by_pose = np.swapaxes(rows.residual, 0, 1).reshape(K, 2 * F, 1)
    gradient = (np.swapaxes(by_pose, 1, 2) @ r_by_pose).ravel() - QA.T @ Qr
    index = visual_index(K)
    H[np.ix_(index, index)] += full
    g[index] += gradient
