"""What the IMU says of a whole navigation's camera poses: gyroscope bias, gravity, metric scale.

The poses come from pictures alone, so their scale and the direction of gravity are open. The linear alignment is that
of VINS-Mono (Qin et al., IEEE T-RO 34(4), 2018, section V-B, eqs. 16-19), over the whole navigation instead of its
first seconds, with the accelerometer's bias among the unknowns. track_alignment.py needs no poses, only a few seconds
of tracks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, so3_log, upright
from station.model.frames import ImuBatch
from station.motion.inertial_track import InertialTrack, usable_intervals

METRIC_SIGMA = 0.10  # a scale less certain than 10 % is not called metric
MAX_INTERVAL_S = 3.0
ACCEL_SLOP = 0.02  # m/s^2: vibration, bias walk, and gravity seen through 0.1 degree of attitude error
# Keyframes closer than this are skipped: over short times the camera's noise, not motion, is compared with the IMU.
MIN_INTERVAL_S = 1.0
# On simulated drives the inertial scale is 3 % off where its own covariance says 2 %.
INERTIAL_SYSTEMATIC = 0.03
POSITION_SLOP = 0.002  # of the median step between keyframes: the camera's own error
ACCEL_BIAS_SIGMA = 0.3  # m/s^2, prior: what data sheets of small IMUs allow


def gyro_bias_from_rotations(
    imu: ImuBatch, t_ns: IntArray, R_world_body: FloatArray, max_interval_s: float = 3.0
) -> tuple[InertialTrack, FloatArray]:
    """The constant gyroscope bias that best explains the rotations seen by the camera.

    Args:
        t_ns: (N,) times of the rotations, the IMU's clock, increasing.
        R_world_body: (N, 3, 3) from structure from motion.
    Returns:
        The track under that bias, and the angles (N-1,) rad by which camera and gyroscope differ per interval (NaN
        where an interval is too long or not covered).
    Source: Qin et al., VINS-Mono, IEEE T-RO 34(4), 2018, eq. 15, with Huber weights.
    """
    track = InertialTrack(imu, np.zeros(3))
    usable = usable_intervals(track, t_ns, max_interval_s)
    residual = np.full((len(t_ns) - 1, 3), np.nan)
    for _ in range(3):
        step = track.increments(t_ns)
        seen = np.swapaxes(R_world_body[:-1], 1, 2) @ R_world_body[1:]
        error = np.swapaxes(step.R, 1, 2) @ seen
        residual = so3_log(error)
        residual[~usable] = np.nan
        if not usable.any():
            break
        J = np.swapaxes(step.R, 1, 2) @ step.R_sum
        size = np.linalg.norm(residual[usable], axis=1)
        cut = 2.0 * max(float(np.median(size)), 1e-4)
        weight = np.sqrt(np.minimum(1.0, cut / np.maximum(size, 1e-12)))
        A = (J[usable] * weight[:, None, None]).reshape(-1, 3)
        b = (-residual[usable] * weight[:, None]).ravel()
        # A bias beyond a few degrees per second is no bias: the weak prior only matters without motion data.
        A = np.vstack([A, 1e-3 * np.eye(3)])
        b = np.concatenate([b, -1e-3 * track.gyro_bias])
        change = np.linalg.lstsq(A, b, rcond=None)[0]
        track = track.with_bias(track.gyro_bias + change)
    return track, np.linalg.norm(residual, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ScaleEstimate:
    """Metres per unit of the reconstruction, and how well one source knows it."""

    scale: float
    sigma_relative: float
    source: str  # "imu", "drive" or "depth"


@dataclass(frozen=True, slots=True, eq=False)
class InertialAlignment:
    scale: ScaleEstimate
    gravity_world: FloatArray  # (3,) m/s^2, pointing down, in the reconstruction's world
    accel_bias: FloatArray  # (3,) m/s^2


def align_to_imu(
    track: InertialTrack,
    t_ns: IntArray,
    R_world_body: FloatArray,
    p_world_cam: FloatArray,
    t_body_cam: FloatArray,
    noise: ImuNoise,
    gravity: float,
) -> InertialAlignment | None:
    """Scale, gravity, velocities and accelerometer bias that make camera and IMU agree; None with too little data.

    Args:
        track: inertial samples under their gyroscope bias.
        t_ns: (N,) keyframe times on the IMU's clock.
        R_world_body: (N, 3, 3); p_world_cam: (N, 3) in units of the reconstruction.
        t_body_cam: (3,) m, the camera in the body: its arm is metric, which alone would give scale away.
        gravity: m/s^2, its known size.
    """
    n = len(t_ns)
    if n < 4:
        return None
    usable = np.flatnonzero(usable_intervals(track, t_ns, MAX_INTERVAL_S))
    if len(usable) < 4:
        return None
    step = track.increments(t_ns)
    arm = R_world_body @ t_body_cam  # camera centre = body + arm
    steps = np.linalg.norm(np.diff(p_world_cam, axis=0), axis=1)
    unit = max(float(np.median(steps[usable])), 1e-9)

    # Unknowns: N velocities, scale / unit, accelerometer bias, gravity. Rows are divided by their sigma.
    scale_at, bias_at, gravity_at = 3 * n, 3 * n + 1, 3 * n + 4
    scale_guess = 1.0
    solution = np.zeros(3 * n + 7)
    weights = np.ones(len(usable))
    g_dir: FloatArray | None = None
    covariance = np.eye(3 * n + 7)
    chi2 = 1.0
    for iteration in range(6):
        rows, rhs = [], []
        for which, i in enumerate(usable):
            dt = step.dt[i]
            var_p = noise.accel_density**2 * dt**3 / 3 + (0.5 * ACCEL_SLOP * dt**2) ** 2
            var_p += (POSITION_SLOP * scale_guess * unit) ** 2 + 1e-8
            var_v = noise.accel_density**2 * dt + (ACCEL_SLOP * dt) ** 2
            R = R_world_body[i]
            row = np.zeros((6, 3 * n + 7))
            row[:3, 3 * i : 3 * i + 3] = -dt * np.eye(3)
            row[:3, scale_at] = p_world_cam[i + 1] - p_world_cam[i]
            row[:3, bias_at : bias_at + 3] = R @ step.R_sum_sum[i]
            row[:3, gravity_at:] = -0.5 * dt**2 * np.eye(3)
            row[3:, 3 * i : 3 * i + 3] = -np.eye(3)
            row[3:, 3 * i + 3 : 3 * i + 6] = np.eye(3)
            row[3:, bias_at : bias_at + 3] = R @ step.R_sum[i]
            row[3:, gravity_at:] = -dt * np.eye(3)
            right = np.concatenate([R @ step.position[i] + arm[i + 1] - arm[i], R @ step.velocity[i]])
            sigma = np.repeat(np.sqrt([var_p, var_v]), 3) / weights[which]
            rows.append(row / sigma[:, None])
            rhs.append(right / sigma)
        A, b = np.vstack(rows), np.concatenate(rhs)
        extra, extra_b = _bias_prior(n, bias_at)
        A_all, b_all = np.vstack([A, extra]), np.concatenate([b, extra_b])
        # Gravity's size is known: two angles are left of its three numbers.
        if g_dir is not None:
            basis = upright(g_dir)[:2].T  # two directions square to it
            b_all = b_all - A_all[:, gravity_at:] @ (gravity * g_dir)
            A_all = np.column_stack([A_all[:, :gravity_at], A_all[:, gravity_at:] @ basis])
        normal = A_all.T @ A_all + 1e-12 * np.eye(A_all.shape[1])
        covariance = np.linalg.inv(normal)
        x = covariance @ (A_all.T @ b_all)
        if g_dir is not None:
            g = gravity * g_dir + basis @ x[gravity_at:]
            solution = np.concatenate([x[:gravity_at], g])
        else:
            solution = x
        g_dir = solution[gravity_at:] / max(float(np.linalg.norm(solution[gravity_at:])), 1e-9)
        scale_guess = max(float(abs(solution[scale_at])), 1e-9)
        residual = (A @ solution - b).reshape(-1, 6)
        size = np.sqrt((residual**2).mean(axis=1)) / weights
        typical = max(float(np.median(size)), 1e-9)
        weights = np.sqrt(np.minimum(1.0, 2.0 * typical / np.maximum(size, 1e-12)))
        chi2 = float((residual**2).sum() / max(1, residual.size - (3 * n + 6 - len(extra))))
        if iteration == 0 and solution[scale_at] <= 0:
            return None
    scale = float(solution[scale_at])
    if scale <= 0:
        return None
    sigma = float(np.sqrt(covariance[scale_at, scale_at] * max(1.0, chi2)))
    return InertialAlignment(
        scale=ScaleEstimate(scale, float(np.hypot(sigma / scale, INERTIAL_SYSTEMATIC)), "imu"),
        gravity_world=solution[gravity_at:],
        accel_bias=solution[bias_at : bias_at + 3],
    )


def spaced(t_ns: IntArray, interval_s: float = MIN_INTERVAL_S) -> IntArray:
    """Indices of keyframes at least an interval apart."""
    chosen = [0]
    for i in range(1, len(t_ns)):
        if t_ns[i] - t_ns[chosen[-1]] >= interval_s * 1e9:
            chosen.append(i)
    return np.array(chosen, dtype=np.int64)


def _bias_prior(n: int, bias_at: int) -> tuple[FloatArray, FloatArray]:
    A = np.zeros((3, 3 * n + 7))
    A[:, bias_at : bias_at + 3] = np.eye(3) / ACCEL_BIAS_SIGMA
    return A, np.zeros(3)


def gravity_from_accelerometer(track: InertialTrack, t_ns: IntArray, R_world_body: FloatArray) -> FloatArray | None:
    """Direction (3,) of gravity, down, from the mean specific force: motion averages out over a navigation."""
    usable = np.flatnonzero(usable_intervals(track, t_ns, 2 * MAX_INTERVAL_S))
    if not len(usable):
        return None
    step = track.increments(t_ns)
    up = np.einsum("nij,nj->i", R_world_body[usable], step.velocity[usable])
    length = float(np.linalg.norm(up))
    return -up / length if length > 0 else None
