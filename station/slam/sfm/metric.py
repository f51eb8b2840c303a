"""Gravity and metric scale of a reconstruction that cameras alone cannot know.

The inertial part is the linear alignment of VINS-Mono (Qin et al., IEEE T-RO 34(4), 2018, section V-B, eqs. 16-19),
over the whole drive instead of its first seconds, with the accelerometer's bias among the unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, rotation_angle
from station.model.frames import DriveSample
from station.slam.mapping.inertial import InertialTrack, usable_intervals

MAX_INTERVAL_S = 3.0
ACCEL_SLOP = 0.02  # m/s^2: vibration, bias walk, and gravity seen through 0.1 degree of attitude error
# Keyframes closer than this are skipped: over short times the camera's noise, not motion, is compared with the IMU.
MIN_INTERVAL_S = 1.0
# On simulated drives the inertial scale is 3 % off where its own covariance says 2 %.
INERTIAL_SYSTEMATIC = 0.03
POSITION_SLOP = 0.002  # of the median step between keyframes: the camera's own error
ACCEL_BIAS_SIGMA = 0.3  # m/s^2, prior: what data sheets of small IMUs allow
MOTOR_LAG_S = 0.15  # the motors follow their command this much later
DRIVE_SYSTEMATIC = 0.05  # wheels slip and batteries sag: a drive command is not known better than that
STRAIGHT_RATE = 0.15  # rad/s: faster turns make wheels slip, and the body is not the turning point


@dataclass(frozen=True, slots=True, eq=False)
class ScaleEstimate:
    """Metres per unit of the reconstruction, and how well one source knows it."""

    scale: float
    sigma_relative: float
    source: str  # "imu" or "drive"


@dataclass(frozen=True, slots=True, eq=False)
class InertialAlignment:
    """What the IMU says of a reconstruction."""

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
            basis = _tangent(g_dir)
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


def _tangent(direction: FloatArray) -> FloatArray:
    """Two unit vectors (3, 2) square to a direction."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(direction, first)])


def gravity_from_accelerometer(track: InertialTrack, t_ns: IntArray, R_world_body: FloatArray) -> FloatArray | None:
    """Direction (3,) of gravity, down, from the mean specific force: motion averages out over a drive."""
    usable = np.flatnonzero(usable_intervals(track, t_ns, 2 * MAX_INTERVAL_S))
    if not len(usable):
        return None
    step = track.increments(t_ns)
    up = np.einsum("nij,nj->i", R_world_body[usable], step.velocity[usable])
    length = float(np.linalg.norm(up))
    return -up / length if length > 0 else None


def scale_from_drive(
    drive: list[DriveSample], t_ns: IntArray, R_world_body: FloatArray, p_world_body: FloatArray
) -> ScaleEstimate | None:
    """Metres per unit from the commanded speed, on straight pieces of about a second; None where there are too few.

    Args:
        t_ns: (N,) keyframe times; p_world_body: (N, 3) in units of the reconstruction.
    """
    if not drive:
        return None
    distance = drive_distance(drive, t_ns)
    ratios, lengths = [], []
    i = 0
    for j in range(1, len(t_ns)):
        span_s = (t_ns[j] - t_ns[i]) * 1e-9
        if span_s < 0.8:
            continue
        commanded = distance[j] - distance[i]
        rates = [abs(d.angular_rad_s) for d in drive if t_ns[i] - 3e8 <= d.t_robot_ns <= t_ns[j]]
        turned = float(rotation_angle(R_world_body[i].T @ R_world_body[j]))
        moved = float(np.linalg.norm(p_world_body[j] - p_world_body[i]))
        straight = turned < STRAIGHT_RATE * span_s and all(rate < STRAIGHT_RATE for rate in rates)
        if straight and abs(commanded) > 0.1 and span_s < 4.0 and moved > 1e-9:
            ratios.append(abs(commanded) / moved)
            lengths.append(abs(commanded))
        i = j
    if len(ratios) < 3:
        return None
    values, weights = np.array(ratios), np.array(lengths)
    order = np.argsort(values)
    middle = np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())
    scale = float(values[order][middle])
    spread = 1.4826 * float(np.median(np.abs(values - scale))) / scale
    return ScaleEstimate(scale, float(np.hypot(spread / np.sqrt(len(values)), DRIVE_SYSTEMATIC)), "drive")


def drive_distance(drive: list[DriveSample], t_ns: IntArray) -> FloatArray:
    """Distance (M,) m that the motors were told to have gone by each time, their lag included."""
    begin = np.array([d.t_robot_ns for d in drive]) * 1e-9 + MOTOR_LAG_S
    speed = np.array([d.linear_m_s for d in drive])
    at = t_ns * 1e-9
    total = np.concatenate([[0.0], np.cumsum(speed[:-1] * np.diff(begin))])
    k = np.searchsorted(begin, at, side="right") - 1
    known = np.maximum(k, 0)
    return np.where(k >= 0, total[known] + speed[known] * (at - begin[known]), 0.0)


def fuse_scales(estimates: list[ScaleEstimate]) -> ScaleEstimate | None:
    """One scale of several, weighted by their certainty; where they contradict each other, less certain for it."""
    if not estimates:
        return None
    logs = np.log([e.scale for e in estimates])
    weights = np.array([e.sigma_relative**-2 for e in estimates])
    mean = float((weights * logs).sum() / weights.sum())
    chi2 = float((weights * (logs - mean) ** 2).sum() / max(1, len(logs) - 1))
    sigma = float(np.sqrt(max(1.0, chi2) / weights.sum()))
    return ScaleEstimate(float(np.exp(mean)), sigma, "+".join(e.source for e in estimates))
