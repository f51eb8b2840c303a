"""Start in motion: gyro bias, gravity, velocity and scale from a short window (docs/slam.md, sec. 8).

1. Gyro bias: with the right rotations, the epipolar plane normals of each pair of frames lie in one plane.
2. Velocity and gravity: linear, once rotations are known; points are eliminated; |g| is given.
3. Refinement of everything by visual-inertial least squares (bundle.py), which also gives the covariance.
Sources: Kneip and Lynen, ICCV 2013 (step 1); Dong-Si and Mourikis, IROS 2012 (step 2).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray, upright
from station.motion import lie
from station.motion.preintegration import Preintegration, compose, preintegrate
from station.slam.mapping.inertial_bundle import Prior, WindowSolution, WindowStates, solve_window
from station.slam.ukf.filter.measurement import CameraModel
from station.slam.ukf.inertial import ImuBuffer
from station.vision.klt import TrackedFrame
from station.vision.lens import BoolArray


@dataclass(frozen=True, slots=True)
class StartConfig:
    """When a start counts as good."""

    min_window_s: float = 0.9
    max_window_s: float = 3.0
    num_keyframes: int = 12
    min_tracks: int = 25
    min_common: int = 10  # tracks that neighbouring views share
    min_parallax_px: float = 12.0  # rotation-compensated, over the tracks' lives
    max_scale_sigma: float = 0.10  # relative standard deviation of the distance travelled
    max_rms: float = 2.0  # whitened reprojection error
    sigma_bias_gyro: float = 0.02  # rad/s, around the estimate of step 1
    sigma_bias_accel: float = 0.1  # m/s^2, around zero
    attempt_every_s: float = 0.2
    still_s: float = 0.5  # at rest for that long: start from gravity alone
    still_flow_px: float = 0.7  # median displacement over still_s
    still_accel: float = 0.35  # m/s^2, standard deviation of the accelerometer
    still_gyro: float = 0.05  # rad/s
    rolling_s: float = 0.5  # driven on its wheels: gravity is averaged over that long
    max_rolling_tilt: float = (
        0.14  # rad; what leans more, or weighs otherwise by max_rolling_accel, is in somebody's hands
    )
    max_rolling_accel: float = 0.6  # m/s^2
    min_rolling_features: int = 20


@dataclass(frozen=True, slots=True, eq=False)
class WindowTracks:
    """Tracks over the K frames of a window."""

    ids: IntArray  # (F,)
    uv_px: FloatArray  # (F, K, 2)
    xy: FloatArray  # (F, K, 2)
    seen: BoolArray  # (F, K)


@dataclass(frozen=True, slots=True, eq=False)
class MotionStart:
    """A successful start: the window's states with covariance, the last being the current one."""

    solution: WindowSolution
    tracks: WindowTracks
    frame_index: IntArray  # (K,)
    t_imu_ns: IntArray  # (K,)


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


def start_in_motion(
    camera: CameraModel,
    noise: ImuNoise,
    gravity: float,
    imu: ImuBuffer,
    frames: list[TrackedFrame],
    frame_index: list[int],
    t_imu_ns: list[int],
    config: StartConfig,
    known_bias: FloatArray | None = None,
) -> MotionStart | str:
    """Solve the window, or say in words what is missing.

    Args:
        known_bias: (6,) from before tracking was lost.
    """
    duration = (t_imu_ns[-1] - t_imu_ns[0]) * 1e-9
    if duration < config.min_window_s:
        return f"needs {config.min_window_s - duration:.1f} s more of images"
    K = min(config.num_keyframes, len(frames))
    pick = np.unique(np.rint(np.linspace(0, len(frames) - 1, K)).astype(int))
    tracks = collect_tracks([frames[i] for i in pick], 3)
    common = (tracks.seen[:, :-1] & tracks.seen[:, 1:]).sum(axis=0)
    if len(tracks.ids) < config.min_tracks or common.min() < config.min_common:
        return (
            f"needs texture: views share {int(common.min())} of {len(tracks.ids)} features, "
            f"{config.min_common} of {config.min_tracks} are the least"
        )
    times = np.array([t_imu_ns[i] for i in pick], dtype=np.int64)
    segments = [imu.segment(int(a), int(b)) for a, b in itertools.pairwise(times)]

    links = [preintegrate(segment, np.zeros(6), noise) for segment in segments]
    bias = estimate_gyro_bias(links, tracks, camera.R_body_cam)
    links = [preintegrate(segment, np.concatenate([bias, np.zeros(3)]), noise) for segment in segments]
    R, dv, dp, t = compose(links)
    parallax_px = _parallax(tracks, R, camera)
    if parallax_px < config.min_parallax_px:
        return f"needs sideways motion: {parallax_px:.0f} px of parallax, {config.min_parallax_px:.0f} are the least"
    try:
        v0, g0 = solve_velocity_and_gravity(R, dp, t, tracks, camera, gravity)
        states = _upright(R, v0, g0, dv, dp, t, bias, links)
        prior = Prior(
            bias,
            np.zeros(3) if known_bias is None else known_bias[3:],
            config.sigma_bias_gyro if known_bias is None else 0.005,
            config.sigma_bias_accel if known_bias is None else 0.05,
        )
        solution = solve_window(
            camera, noise, gravity, states, links, tracks.uv_px, tracks.xy, tracks.seen, prior, iterations=12
        )
    except DegenerateGeometry as exc:
        return f"needs other motion: {exc}"
    travelled = solution.states.x[-1] - solution.states.x[0]
    distance = float(np.linalg.norm(travelled))
    scale_sigma = _scale_sigma(solution, travelled, distance)
    if solution.rms > config.max_rms:
        return f"needs motion and features that agree: they differ by {solution.rms * camera.sigma_px:.1f} px"
    if scale_sigma > config.max_scale_sigma:
        return f"needs more acceleration: the scale is known to {100 * min(scale_sigma, 9.99):.0f} % only"
    return MotionStart(solution, tracks, np.array([frame_index[i] for i in pick]), times)


def estimate_gyro_bias(links: list[Preintegration], tracks: WindowTracks, R_body_cam: FloatArray) -> FloatArray:
    """Gyro bias (3,) rad/s that makes the plane normals n = a x R b of each pair of frames coplanar.

    Gauss-Newton on t . n over the bias and one direction t per pair; the directions are projected out.
    """
    rays = np.concatenate([tracks.xy, np.ones((*tracks.xy.shape[:2], 1))], axis=2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    rays = rays @ R_body_cam.T  # body frame
    K = tracks.seen.shape[1]
    pairs = [(i, i + step) for step in (1, 3) for i in range(K - step)]
    bias = np.zeros(3)
    for iteration in range(10):
        H, gradient = np.eye(3) * 1e-9, np.zeros(3)
        for i, j in pairs:
            both = tracks.seen[:, i] & tracks.seen[:, j]
            if both.sum() < 12:
                continue
            r, J = _coplanarity(links[i:j], bias, rays[both, i], rays[both, j])
            scale = max(1.5 * float(np.median(np.abs(r))), 1e-5)
            weight = 1.0 / (1.0 + (r / scale) ** 2) if iteration > 1 else np.ones(len(r))
            H += (J * weight[:, None]).T @ J
            gradient += (J * weight[:, None]).T @ r
        step = np.linalg.solve(H, -gradient)
        bias = bias + np.clip(step, -0.1, 0.1)
        if float(np.abs(step).max()) < 1e-6:
            break
    return bias


def _coplanarity(
    links: list[Preintegration], bias: FloatArray, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals t . (a x R b) (n,) at the best direction t; their derivative (n, 3) by the bias, t's part taken out."""
    R, by_bias = np.eye(3), np.zeros((3, 3))
    for link in links:
        part = link.dR @ lie.so3_exp(link.dR_by_bias @ (bias - link.bias[:3]))
        R, by_bias = R @ part, part.T @ by_bias + link.dR_by_bias
    normals = np.cross(a, b @ R.T)
    _, basis = np.linalg.eigh(normals.T @ normals)
    t = basis[:, 0]
    J = np.cross(t, a)[:, None, :] @ (-R @ lie.skew(b) @ by_bias)  # t . (a x dRb) = (t x a) . dRb
    J = J[:, 0]
    Q = np.linalg.qr(normals @ basis[:, 1:])[0]
    return normals @ t, J - Q @ (Q.T @ J)


def _parallax(tracks: WindowTracks, R: FloatArray, camera: CameraModel) -> float:
    """Displacement (px) between first and last view of a track that rotation does not explain: upper quartile."""
    F, K = tracks.seen.shape
    first, last = np.argmax(tracks.seen, axis=1), K - 1 - np.argmax(tracks.seen[:, ::-1], axis=1)
    row = np.arange(F)
    R_wc = R @ camera.R_body_cam
    rays = np.column_stack([tracks.xy[row, last], np.ones(F)])
    rays = np.einsum("fji,fj->fi", R_wc[first], np.einsum("fij,fj->fi", R_wc[last], rays))
    moved = rays[:, :2] / np.maximum(rays[:, 2:], 0.1) - tracks.xy[row, first]
    return float(np.percentile(np.linalg.norm(moved, axis=1), 75)) * camera.lens.camera.fx


def solve_velocity_and_gravity(
    R: FloatArray, dp: FloatArray, t: FloatArray, tracks: WindowTracks, camera: CameraModel, gravity: float
) -> tuple[FloatArray, FloatArray]:
    """Velocity (3,) at the first pose and gravity (3,), in the first body frame.

    Pose k is at v0 t + g t^2 / 2 + dp. Each observation says that its point lies on a ray; the point is eliminated, and
    (v0, g) follow from linear least squares under |g| = gravity.
    """
    F, K = tracks.seen.shape
    rays = np.concatenate([tracks.xy, np.ones((F, K, 1))], axis=2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    rays = np.einsum("kij,fkj->fki", R @ camera.R_body_cam, rays)
    P = (np.eye(3) - rays[..., :, None] * rays[..., None, :]) * tracks.seen[..., None, None]
    s = dp + R @ camera.t_body_cam  # camera centre at zero velocity and gravity
    T = np.zeros((K, 3, 6))
    T[:, :, :3] = t[:, None, None] * np.eye(3)
    T[:, :, 3:] = 0.5 * (t * t)[:, None, None] * np.eye(3)
    weight = np.ones((F, K))
    y = np.zeros(6)
    for _ in range(3):
        Pw = P * weight[..., None, None]
        A = Pw.sum(axis=1) + 1e-9 * np.eye(3)
        PT = Pw @ T  # (F, K, 3, 6)
        Ps = (Pw @ s[..., None])[..., 0]
        A_inv_PT = np.linalg.solve(A, PT.sum(axis=1))
        A_inv_Ps = np.linalg.solve(A, Ps.sum(axis=1)[..., None])[..., 0]
        H = np.einsum("kia,fkib->ab", T, PT) - np.einsum("fia,fib->ab", PT.sum(axis=1), A_inv_PT)
        b = -np.einsum("kia,fki->a", T, Ps) + np.einsum("fia,fi->a", PT.sum(axis=1), A_inv_Ps)
        y = _with_gravity(0.5 * (H + H.T), b, gravity)
        points = np.einsum("fia,a->fi", A_inv_PT, y) + A_inv_Ps
        depth = np.linalg.norm(points[:, None] - (T @ y + s)[None], axis=2)
        weight = 1.0 / np.maximum(depth, 0.1) ** 2  # metres to angles
    return y[:3], y[3:]


def _with_gravity(H: FloatArray, b: FloatArray, gravity: float) -> FloatArray:
    """Minimiser (6,) of y^T H y / 2 - b^T y with |y[3:]| = gravity, by the multiplier's secular equation."""
    H_vv, H_vg, H_gg = H[:3, :3], H[:3, 3:], H[3:, 3:]
    reduce = np.linalg.solve(H_vv + 1e-12 * np.eye(3), np.column_stack([H_vg, b[:3]]))
    M = H_gg - H_vg.T @ reduce[:, :3]
    c = b[3:] - H_vg.T @ reduce[:, 3]
    eigen = np.linalg.eigh(0.5 * (M + M.T))
    w: FloatArray = np.asarray(eigen[0], dtype=np.float64)
    U = eigen[1]
    z = U.T @ c

    def length(shift: float) -> float:
        return float(np.linalg.norm(z / (w + shift)))

    smallest, largest = float(w[0]), float(w[2])
    reach = float(np.linalg.norm(z)) / gravity + largest + 1e-9
    low: float = 1e-12 * largest - smallest
    high: float = low + reach
    for _ in range(200):
        middle = 0.5 * (low + high)
        if length(middle) > gravity:
            low = middle
        else:
            high = middle
    shifted = w + 0.5 * (low + high)
    g = U @ (z / shifted)
    g *= gravity / max(float(np.linalg.norm(g)), 1e-9)
    return np.concatenate([reduce[:, 3] - reduce[:, :3] @ g, g])


def _upright(
    R: FloatArray,
    v0: FloatArray,
    g0: FloatArray,
    dv: FloatArray,
    dp: FloatArray,
    t: FloatArray,
    bias: FloatArray,
    links: list[Preintegration],
) -> WindowStates:
    """States in a world frame with z up, origin in the first pose."""
    up = upright(-g0, np.eye(3))
    v = v0 + t[:, None] * g0 + dv
    x = v0 * t[:, None] + 0.5 * (t * t)[:, None] * g0 + dp
    omega = np.array([lie.so3_log(link.dR) / link.duration_s for link in links])
    return WindowStates(
        R=up @ R,
        v=v @ up.T,
        x=x @ up.T,
        bias=np.tile(np.concatenate([bias, np.zeros(3)]), (len(t), 1)),
        omega=np.concatenate([omega, omega[-1:]]),
    )


def _scale_sigma(solution: WindowSolution, travelled: FloatArray, distance: float) -> float:
    """Relative standard deviation of the distance between first and last pose."""
    last = 15 * (len(solution.states.x) - 1) + 6
    cov = solution.covariance[last : last + 3, last : last + 3]
    along = travelled / max(distance, 1e-9)
    variance = float(along @ cov @ along)
    return float(np.sqrt(max(variance, 0.0))) / max(distance, 1e-9)
