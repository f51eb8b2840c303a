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
from station.slam.ukf.bundle import N, Prior, WindowStates, solve_window
from station.slam.ukf.keyframes import Keyframe
from station.slam.ukf.measurement import CameraModel
from station.slam.ukf.motion_start import WindowTracks, collect_tracks

WINDOW = 24
STEP = 12
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
    result = list(keyframes)
    messages: list[str] = []
    sigma_bias = np.repeat([sigma_bias_gyro, sigma_bias_accel], 3)
    unknown = np.concatenate([np.full(3, 0.05), np.full(3, 0.3), np.zeros(3), sigma_bias])
    for first, end in _linked_parts(result):
        sigma_first, start = unknown, first
        while end - start >= MIN_KEYFRAMES:
            stop = min(start + WINDOW, end)
            try:
                refined, sigma = _refine_window(result[start:stop], camera, noise, gravity, sigma_first)
            except DegenerateGeometry as exc:
                messages.append(f"{stop - start} keyframes were left as the filter had them: {exc}")
                sigma_first = unknown
            else:
                result[start:stop] = refined
                sigma_first = sigma[min(STEP, len(sigma) - 1)]
            if stop == end:
                break
            start += STEP
    return result, messages


def _linked_parts(keyframes: list[Keyframe]) -> list[tuple[int, int]]:
    """Ranges [first, end) of keyframes that IMU links connect without a break."""
    breaks = [i for i, k in enumerate(keyframes) if i == 0 or k.link is None]
    return list(itertools.pairwise([*breaks, len(keyframes)]))


def _refine_window(
    part: list[Keyframe], camera: CameraModel, noise: ImuNoise, gravity: float, first_sigma: FloatArray
) -> tuple[list[Keyframe], FloatArray]:
    """The window's keyframes refined, and the standard deviations (K, 15) of their states."""
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
    solution = solve_window(camera, noise, gravity, states, links, tracks.uv_px, tracks.xy, tracks.seen, prior)
    known = solution.points.is_good & (solution.points.depth_sigma < MAX_DEPTH_SIGMA)
    if known.sum() < MIN_POINTS or solution.rms > MAX_RMS or not solution.has_converged:
        raise DegenerateGeometry("the features show too little parallax")
    s = solution.states
    refined = [replace(k, T_world_body=se3(s.R[i], s.x[i]), v_world=s.v[i], bias=s.bias[i]) for i, k in enumerate(part)]
    sigma = np.sqrt(np.maximum(np.diag(solution.covariance), 0.0)).reshape(-1, N)
    return refined, sigma


def _longest(tracks: WindowTracks) -> WindowTracks:
    """At most MAX_TRACKS tracks, those with most views."""
    order = np.argsort(-tracks.seen.sum(axis=1), kind="stable")[:MAX_TRACKS]
    order = np.sort(order)
    return WindowTracks(tracks.ids[order], tracks.uv_px[order], tracks.xy[order], tracks.seen[order])
