"""Navigations of made-up furnished rooms, as a SLAM backend would deliver them: for tests, with their truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.geometry import FloatArray, IntArray, carry_poses, inverse, se3, transform, yaw_rotation
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory

CAMERA = CameraCalibration(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # x forward, y left, z up


@dataclass(frozen=True, slots=True, eq=False)
class Home:
    """Textured points on furniture and walls of one room, world frame, metres."""

    p: FloatArray  # (N, 3)
    rgb: FloatArray  # (N, 3)
    furniture: IntArray  # (N,) which piece of furniture; -1 on walls
    size: FloatArray  # (2,) m


def furnished_room(seed: int, *, pieces: int = 7, size: tuple[float, float] = (5.0, 4.0), density: int = 120) -> Home:
    """A room with boxes along its walls and a few pictures; `density` points on each piece."""
    rng = np.random.default_rng(seed)
    points, owner = [], []
    perimeter = 2 * sum(size)
    for piece in range(pieces):
        along = (piece + 0.25 + 0.5 * rng.random()) * perimeter / pieces
        centre = np.append(_on_wall(along, size, inset=0.4), 0.0)
        extent = rng.uniform([0.4, 0.4, 0.5], [0.8, 0.8, 1.2])
        face = rng.integers(0, 3, density)
        p = rng.uniform(-0.5, 0.5, (density, 3))
        p[np.arange(density), face] = np.where(rng.random(density) < 0.5, -0.5, 0.5)
        points.append(centre + (p + np.array([0, 0, 0.5])) * extent)
        owner.append(np.full(density, piece))
    walls = np.array([[*_on_wall(a, size, inset=0.0), z] for a, z in rng.uniform([0, 0], [perimeter, 2.3], (60, 2))])
    points.append(walls)
    owner.append(np.full(len(walls), -1))
    p = np.concatenate(points)
    return Home(p=p, rgb=rng.uniform(0, 255, p.shape), furniture=np.concatenate(owner), size=np.array(size))


def _on_wall(along: float, size: tuple[float, float], inset: float) -> FloatArray:
    w, h = size
    along %= 2 * (w + h)
    sides: list[tuple[float, Callable[[float], tuple[float, float]]]] = [
        (w, lambda s: (s, inset)),
        (h, lambda s: (w - inset, s)),
        (w, lambda s: (w - s, h - inset)),
    ]
    for length, place in sides:
        if along < length:
            return np.array(place(along), dtype=np.float64)
        along -= length
    return np.array([inset, h - along])


def drive(home: Home, seed: int, *, frames: int = 60, turns: float = 2.0, radius: float = 0.8) -> FloatArray:
    """(frames, 4, 4) T_world_cam of a robot circling in the room, looking outwards."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(0, 2 * np.pi)
    poses = []
    for k in range(frames):
        angle = start + 2 * np.pi * turns * k / frames
        centre = home.size / 2 + radius * rng.uniform(0.8, 1.2) * np.array([np.cos(angle), np.sin(angle)])
        R = yaw_rotation(angle + rng.normal(0, 0.15)) @ R_BODY_CAM
        poses.append(se3(R, np.append(centre, 0.4)))
    return np.array(poses)


def navigate(
    home: Home,
    T_world_cam: FloatArray,
    seed: int,
    *,
    name: str = "",
    noise_m: float = 0.01,
    seen_share: float = 0.6,
    outlier_share: float = 0.03,
    T_nav_world: FloatArray | None = None,
    metric: bool = True,
    gravity: bool = True,
    max_range_m: float = 3.5,
    images: bool = True,
) -> Navigation:
    """What SLAM would make of a drive: noisy points of what was in view, in the navigation's own frame.

    `T_nav_world` may carry a scale (then say metric=False); its default is the identity.
    """
    rng = np.random.default_rng(seed)
    T = np.eye(4) if T_nav_world is None else T_nav_world
    chosen = np.flatnonzero(rng.random(len(home.p)) < seen_share)
    p_cam = np.array([transform(inverse(pose), home.p[chosen]) for pose in T_world_cam])  # (F, n, 3)
    uv = p_cam[..., :2] / np.maximum(p_cam[..., 2:], 1e-6) * 120.0 + [79.5, 59.5]
    visible = (p_cam[..., 2] > 0.3) & (np.linalg.norm(p_cam, axis=2) < max_range_m)
    visible &= (uv >= 0).all(axis=2) & (uv < [160, 120]).all(axis=2)
    visible &= rng.random(visible.shape) < 0.8
    landmark = np.flatnonzero(visible.sum(axis=0) >= 3)
    frame, point = np.nonzero(visible[:, landmark])
    p = home.p[chosen[landmark]] + rng.normal(0, noise_m, (len(landmark), 3))
    wrong = rng.random(len(p)) < outlier_share
    p[wrong] += rng.normal(0, 1.0, (int(wrong.sum()), 3))
    poses = carry_poses(T, T_world_cam)
    t = np.arange(len(poses), dtype=np.int64) * 100_000_000
    rgb = home.rgb[chosen[landmark]].astype(np.uint8)
    encoded = tuple(_picture(uv[k, landmark[point[frame == k]]], rgb[point[frame == k]]) for k in range(len(poses)))
    return Navigation(
        id=name or f"synthetic-{seed}",
        calibration=Calibration(camera=CAMERA, imu=None),
        trajectory=Trajectory(t, poses),
        keyframes=Keyframes(
            frame_index=np.arange(len(poses)),
            t_robot_ns=t,
            T_world_cam=poses,
            encoded=encoded if images else tuple(b"" for _ in poses),
            segment=np.zeros(len(poses), dtype=np.int64),
        ),
        landmarks=Landmarks(
            p_world=transform(T, p),
            rgb=rgb,
            cov_world=np.zeros((len(p), 3, 3)),
            observed_landmark=point.astype(np.int64),
            observed_keyframe=frame.astype(np.int64),
            observed_uv_px=uv[frame, landmark[point]],
        ),
        report=report(scale="metric" if metric else "arbitrary", gravity=gravity, frames=len(poses), landmarks=len(p)),
    )


def report(*, scale: str = "metric", gravity: bool = True, frames: int = 0, landmarks: int = 0) -> NavigationReport:
    return NavigationReport(
        backend="synthetic",
        frames=frames,
        duration_s=frames * 0.1,
        wall_s=0.0,
        realtime_factor=1.0,
        cpu_s=0.0,
        landmarks=landmarks,
        tracking_lost_s=0.0,
        scale="metric" if scale == "metric" else "arbitrary",
        gravity_aligned=gravity,
        seed=0,
        versions={},
        config={},
    )


def with_points(navigation: Navigation, p: FloatArray) -> Navigation:
    """The navigation with other landmark positions and no observations."""
    none = np.zeros(0, dtype=np.int64)
    landmarks = Landmarks(p, np.zeros((len(p), 3), np.uint8), np.zeros((len(p), 3, 3)), none, none, np.zeros((0, 2)))
    return replace(navigation, landmarks=landmarks)


def _picture(uv: FloatArray, rgb: FloatArray) -> bytes:
    image = np.full((120, 160, 3), 128, dtype=np.uint8)
    for (u, v), colour in zip(uv, rgb, strict=True):
        cv2.circle(image, (int(u), int(v)), 2, [int(c) for c in colour[::-1]], -1)
    return bytes(cv2.imencode(".jpg", image)[1])
