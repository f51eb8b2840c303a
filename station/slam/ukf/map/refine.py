"""Refining a segment's keyframes when the drive has ended: overlapping windows of visual-inertial least squares.

Each window starts where an earlier one has been; that pose, its velocity and biases are held with their uncertainty, so
the cost grows linearly with the drive (docs/slam.md, sec. 10).
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from shared.calibration import ImuNoise
from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, se3
from station.slam.mapping.inertial_bundle import solve_window
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.pose_log import follow_poses
from station.slam.ukf.map.windows import Spacer, window_of
from station.vision.camera_model import CameraModel

WINDOW = 24
STEP = 12
MIN_KEYFRAMES = 4
MIN_POINTS = 20
MAX_RMS = 3.0  # whitened
MAX_DEPTH_SIGMA = 0.3  # relative; a window without enough such points has no parallax to refine by


def refine_segment(
    keyframes: list[Keyframe],
    camera: CameraModel,
    noise: ImuNoise,
    gravity: float,
    sigma_bias_gyro: float = 0.01,
    sigma_bias_accel: float = 0.1,
) -> tuple[list[Keyframe], list[str]]:
    """Keyframes with better poses, velocities and biases; and what could not be refined, in sentences."""
    spaced = _spaced(keyframes)
    result = list(spaced)
    messages: list[str] = []
    sigma_bias = np.repeat([sigma_bias_gyro, sigma_bias_accel], 3)
    unknown = np.concatenate([np.full(3, 0.05), np.full(3, 0.3), np.zeros(3), sigma_bias])
    for first, end in _linked_parts(result):
        sigma_first, start = unknown, first
        while end - start >= MIN_KEYFRAMES:
            stop = min(start + WINDOW, end)
            try:
                refined, sigma_first = _refine_window(result[start:stop], camera, noise, gravity, sigma_first)
            except DegenerateGeometry as exc:
                messages.append(f"{stop - start} keyframes were left as the filter had them: {exc}")
                sigma_first = unknown
            else:
                result[start:stop] = refined
            if stop == end:
                break
            start += STEP
    return _follow(keyframes, spaced, result), messages


def _spaced(keyframes: list[Keyframe]) -> list[Keyframe]:
    """Those far enough apart, with the IMU links of the others joined to theirs."""
    spacer = Spacer()
    return [chosen for k in keyframes if (chosen := spacer.add(k)) is not None]


def _follow(keyframes: list[Keyframe], spaced: list[Keyframe], refined: list[Keyframe]) -> list[Keyframe]:
    """All keyframes: the refined ones, and between them the others moved along."""
    if not keyframes:
        return []
    moved = follow_poses(
        np.array([k.T_world_head for k in keyframes]),
        np.array([k.image.t_robot_ns for k in keyframes]),
        np.array([k.T_world_head for k in spaced]),
        np.array([k.T_world_head for k in refined]),
        np.array([k.image.t_robot_ns for k in spaced]),
    )
    known = {k.image.index: k for k in refined}
    result = []
    for k, T in zip(keyframes, moved, strict=True):
        better = known.get(k.image.index)
        if better is None:
            turn = T[:3, :3] @ k.T_world_head[:3, :3].T
            result.append(replace(k, T_world_head=T, v_world=turn @ k.v_world))
        else:
            result.append(replace(better, link=k.link))
    return result


def _linked_parts(keyframes: list[Keyframe]) -> list[tuple[int, int]]:
    """Ranges [first, end) of keyframes that IMU links connect without a break."""
    breaks = [i for i, k in enumerate(keyframes) if i == 0 or k.link is None]
    return list(itertools.pairwise([*breaks, len(keyframes)]))


def _refine_window(
    part: list[Keyframe], camera: CameraModel, noise: ImuNoise, gravity: float, first_sigma: FloatArray
) -> tuple[list[Keyframe], FloatArray]:
    """The window's keyframes refined, and the standard deviations (15,) of the state with which the next begins."""
    window = window_of(part, first_sigma)
    solution = solve_window(camera, noise, gravity, window.states, window.links, window.tracks, window.prior)
    known = solution.points.is_good & (solution.points.depth_sigma < MAX_DEPTH_SIGMA)
    if known.sum() < MIN_POINTS or solution.rms > MAX_RMS or not solution.has_converged:
        raise DegenerateGeometry("the features show too little parallax")
    s = solution.states
    refined = [replace(k, T_world_head=se3(s.R[i], s.x[i]), v_world=s.v[i], bias=s.bias[i]) for i, k in enumerate(part)]
    following = min(STEP, len(part) - 1)
    return refined, np.sqrt(np.maximum(np.diag(solution.covariance_of(following)), 0.0))
