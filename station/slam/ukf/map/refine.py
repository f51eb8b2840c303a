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
from station.motion.preintegration import Preintegration, chain
from station.slam.mapping.inertial_bundle import Prior, WindowStates, WindowTracks, collect_tracks, solve_window
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.pose_log import follow_poses
from station.vision.camera_model import CameraModel

WINDOW = 24
STEP = 12
# Keyframes nearer to each other move along with their neighbours. In fast turns they come 0.05 s apart, and windows of
# a second know little of tilt and scale (docs/studies/ukf.md).
SPACING_S = 0.149
MAX_TRACKS = 150
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
    """Those at least SPACING_S apart, with the IMU links of the others joined to theirs."""
    chosen: list[Keyframe] = []
    link: Preintegration | None = None  # since the chosen one before
    for k in keyframes:
        if k.link is None or not chosen:
            chosen.append(k)
            link = None
            continue
        link = k.link if link is None else chain(link, k.link)
        if (k.image.t_robot_ns - chosen[-1].image.t_robot_ns) * 1e-9 < SPACING_S:
            continue
        chosen.append(replace(k, link=link))
        link = None
    return chosen


def _follow(keyframes: list[Keyframe], spaced: list[Keyframe], refined: list[Keyframe]) -> list[Keyframe]:
    """All keyframes: the refined ones, and between them the others moved along."""
    if not keyframes:
        return []
    moved = follow_poses(
        np.array([k.T_world_body for k in keyframes]),
        np.array([k.image.t_robot_ns for k in keyframes]),
        np.array([k.T_world_body for k in spaced]),
        np.array([k.T_world_body for k in refined]),
        np.array([k.image.t_robot_ns for k in spaced]),
    )
    known = {k.image.index: k for k in refined}
    result = []
    for k, T in zip(keyframes, moved, strict=True):
        better = known.get(k.image.index)
        if better is None:
            turn = T[:3, :3] @ k.T_world_body[:3, :3].T
            result.append(replace(k, T_world_body=T, v_world=turn @ k.v_world))
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
    tracks = _longest(collect_tracks([k.tracked for k in part], 3))
    if len(tracks.ids) < MIN_POINTS:
        raise DegenerateGeometry("too few features were followed")
    states = WindowStates(
        R=np.array([k.T_world_body[:3, :3] for k in part]),
        v=np.array([k.v_world for k in part]),
        x=np.array([k.T_world_body[:3, 3] for k in part]),
        bias=np.array([k.bias for k in part]),
        omega=np.array([k.omega_body for k in part]),
    )
    links = [k.link for k in part[1:] if k.link is not None]
    wheels = [k.wheels for k in part]
    has_wheels = any(w is not None for w in wheels)
    nothing = (np.zeros(3), np.full(3, np.inf))
    prior = Prior(
        bias_gyro=states.bias[0, :3],
        bias_accel=states.bias[0, 3:],
        sigma_bias_gyro=float(first_sigma[9:12].mean()),
        sigma_bias_accel=float(first_sigma[12:].mean()),
        v_first=states.v[0],
        sigma_v=max(float(first_sigma[3:6].mean()), 1e-3),
        R_first=states.R[0],
        sigma_phi=max(float(first_sigma[:3].mean()), 1e-4),
        v_body=np.array([(w or nothing)[0] for w in wheels]) if has_wheels else None,
        sigma_v_body=np.array([(w or nothing)[1] for w in wheels]) if has_wheels else None,
    )
    solution = solve_window(camera, noise, gravity, states, links, tracks, prior)
    known = solution.points.is_good & (solution.points.depth_sigma < MAX_DEPTH_SIGMA)
    if known.sum() < MIN_POINTS or solution.rms > MAX_RMS or not solution.has_converged:
        raise DegenerateGeometry("the features show too little parallax")
    s = solution.states
    refined = [replace(k, T_world_body=se3(s.R[i], s.x[i]), v_world=s.v[i], bias=s.bias[i]) for i, k in enumerate(part)]
    following = min(STEP, len(part) - 1)
    return refined, np.sqrt(np.maximum(np.diag(solution.covariance_of(following)), 0.0))


def _longest(tracks: WindowTracks) -> WindowTracks:
    """At most MAX_TRACKS tracks, those with most views."""
    order = np.argsort(-tracks.seen.sum(axis=1), kind="stable")[:MAX_TRACKS]
    order = np.sort(order)
    return WindowTracks(tracks.ids[order], tracks.uv_px[order], tracks.xy[order], tracks.seen[order])
