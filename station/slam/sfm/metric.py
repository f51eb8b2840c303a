"""Metric scale from drive commands, and one scale of several; the IMU's is found in mapping/pose_alignment.py."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray, rotation_angle
from station.model.frames import DriveSample
from station.motion.drive_commands import wheel_motion
from station.slam.mapping.pose_alignment import ScaleEstimate

DRIVE_SYSTEMATIC = 0.05  # wheels slip and batteries sag: a drive command is not known better than that
STRAIGHT_RATE = 0.15  # rad/s: faster turns make wheels slip, and the body is not the turning point


def scale_from_drive(
    drive: list[DriveSample], t_ns: IntArray, R_world_body: FloatArray, p_world_body: FloatArray
) -> ScaleEstimate | None:
    """Metres per unit from the commanded speed, on straight pieces of about a second; None where there are too few.

    Args:
        t_ns: (N,) keyframe times; p_world_body: (N, 3) in units of the reconstruction.
    """
    if not drive:
        return None
    _, distance = wheel_motion(drive, t_ns)
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
