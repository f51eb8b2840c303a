"""Start in motion from a short window: bias, gravity, velocity and scale, or what is missing (docs/slam.md, sec. 8).

A first guess without poses (mapping/track_alignment.py) is refined by visual-inertial least squares
(mapping/inertial_bundle.py), which also gives the covariance.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray, so3_log, upright
from station.motion.imu_buffer import ImuBuffer
from station.motion.preintegration import Preintegration, compose, preintegrate
from station.slam.mapping.inertial_bundle import (
    Prior,
    WindowSolution,
    WindowStates,
    WindowTracks,
    collect_tracks,
    solve_window,
)
from station.slam.mapping.track_alignment import gyro_bias_from_tracks, solve_velocity_and_gravity
from station.vision.camera_model import CameraModel
from station.vision.klt import TrackedFrame


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
    max_rolling_tilt: float = 0.14  # rad; what leans more, or weighs otherwise by the next, is in somebody's hands
    max_rolling_accel: float = 0.6  # m/s^2
    min_rolling_features: int = 20


@dataclass(frozen=True, slots=True, eq=False)
class MotionStart:
    """A successful start: the window's states with covariance, the last being the current one."""

    solution: WindowSolution
    tracks: WindowTracks
    frame_index: IntArray  # (K,)
    t_imu_ns: IntArray  # (K,)


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
    bias = gyro_bias_from_tracks(links, tracks, camera.R_body_cam)
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
        solution = solve_window(camera, noise, gravity, states, links, tracks, prior, iterations=12)
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
    omega = np.array([so3_log(link.dR) / link.duration_s for link in links])
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
