"""Navigations through empty flats: landmarks on the walls, seen where no wall hides them. No pictures, no SLAM."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from shared.calibration import Calibration
from shared.geometry import FloatArray, carry_poses, se3, yaw_rotation
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.places.rooms.surfaces import Seen, Surfaces, find_surfaces
from tests.support.places import R_BODY_CAM
from tests.support.rooms import CAMERA

STEP_M, HEIGHTS_M = 0.08, (0.3, 0.7, 1.1)
HALF_VIEW_RAD = 0.5
Wall = tuple[tuple[float, float], tuple[float, float]]

# Two rooms of 4 x 4 m, a wall of 10 cm between them with a door 0.9 m wide.
TWO_ROOMS: tuple[Wall, ...] = (
    ((0.0, 0.0), (4.0, 0.0)), ((0.0, 4.0), (4.0, 4.0)), ((0.0, 0.0), (0.0, 4.0)),
    ((4.1, 0.0), (8.1, 0.0)), ((4.1, 4.0), (8.1, 4.0)), ((8.1, 0.0), (8.1, 4.0)),
    ((4.0, 0.0), (4.0, 1.5)), ((4.0, 2.4), (4.0, 4.0)), ((4.1, 0.0), (4.1, 1.5)), ((4.1, 2.4), (4.1, 4.0)),
    ((4.0, 1.5), (4.1, 1.5)), ((4.0, 2.4), (4.1, 2.4)),
)  # fmt: skip
DOOR = (4.05, 1.95)
WAY_OF_TWO = ((2.0, 2.0), (3.0, 1.95), (5.2, 1.95), (6.1, 2.0))
# An L: 5 x 5 m without a corner of 2.5 x 2.5 m.
ELL: tuple[Wall, ...] = (
    ((0.0, 0.0), (5.0, 0.0)), ((0.0, 0.0), (0.0, 5.0)), ((0.0, 5.0), (2.5, 5.0)),
    ((2.5, 5.0), (2.5, 2.5)), ((2.5, 2.5), (5.0, 2.5)), ((5.0, 2.5), (5.0, 0.0)),
)  # fmt: skip
WAY_OF_ELL = ((1.25, 3.8), (1.3, 1.3), (3.8, 1.25))


def surfaces_seen(seen: Seen) -> Surfaces:
    """Of what is known to show some: there are none of a flat without landmarks, or too large for a grid."""
    return cast(Surfaces, find_surfaces(seen))


def navigate(walls: Sequence[Wall], way: Sequence[tuple[float, float]], seed: int = 0) -> Navigation:
    """Along the way, turning once around at every 0.4 m of it; landmarks err by 1 cm."""
    rng = np.random.default_rng(seed)
    stops = _along(np.array(way), 0.4)
    yaw = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    xy, heading = np.repeat(stops, len(yaw), axis=0), np.tile(yaw, len(stops))
    p, wall_of = _landmarks(walls)
    pairs = [(m, k) for k in range(len(xy)) for m in _seen(xy[k], heading[k], p, wall_of, walls)]
    landmark, keyframe = np.array(pairs, dtype=np.int64).T
    T = np.stack([se3(yaw_rotation(a), np.array([*q, 0.25])) for q, a in zip(xy, heading, strict=True)])
    t, count = np.arange(len(xy)) * 10**8, len(p)
    return Navigation(
        id="flat",
        calibration=Calibration(camera=CAMERA, imu=None, rig="wheels"),
        trajectory=Trajectory(t, T),
        keyframes=Keyframes(
            np.arange(len(t)), t, T @ se3(R_BODY_CAM, np.zeros(3)), (b"",) * len(t), np.zeros(len(t), dtype=np.int64)
        ),
        landmarks=Landmarks(
            p + rng.normal(0, 0.01, p.shape),
            np.zeros((count, 3), np.uint8),
            np.zeros((count, 3, 3)),
            landmark,
            keyframe,
            np.zeros((len(landmark), 2)),
        ),
        report=NavigationReport("test", len(t), 1, 1, 1, 1, count, 0, "metric", True, 0, {}, {}),
    )


def moved(navigation: Navigation, T: FloatArray) -> Navigation:
    """The same in another frame: a similarity T (4, 4)."""
    keyframes, trajectory = navigation.keyframes, navigation.trajectory
    return replace(
        navigation,
        keyframes=replace(keyframes, T_world_cam=carry_poses(T, keyframes.T_world_cam)),
        trajectory=replace(trajectory, T_world_body=carry_poses(T, trajectory.T_world_body)),
        landmarks=navigation.landmarks.moved(T),
    )


def _along(way: FloatArray, step: float) -> FloatArray:
    pieces = [
        a + np.linspace(0, 1, max(2, round(float(np.linalg.norm(b - a)) / step) + 1))[:-1, None] * (b - a)
        for a, b in itertools.pairwise(way)
    ]
    return np.concatenate([*pieces, way[-1:]])


def _landmarks(walls: Sequence[Wall]) -> tuple[FloatArray, np.ndarray]:
    p, wall_of = [np.zeros((1, 3))], [np.array([-1])]  # one on the floor, as low as it is
    for number, (a, b) in enumerate(walls):
        xy = _along(np.array([a, b]), STEP_M)
        for z in HEIGHTS_M:
            p.append(np.column_stack([xy, np.full(len(xy), z)]))
            wall_of.append(np.full(len(xy), number))
    return np.concatenate(p), np.concatenate(wall_of)


def _seen(eye: FloatArray, yaw: float, p: FloatArray, wall_of: np.ndarray, walls: Sequence[Wall]) -> FloatArray:
    """Landmarks in view that no wall stands before."""
    d = p[:, :2] - eye
    off = (np.arctan2(d[:, 1], d[:, 0]) - yaw + np.pi) % (2 * np.pi) - np.pi
    ahead = np.flatnonzero(np.abs(off) < HALF_VIEW_RAD)
    hidden = np.zeros(len(ahead), dtype=np.bool_)
    for number, (a, b) in enumerate(np.array(walls)):
        hidden |= (wall_of[ahead] != number) & _crosses(eye, d[ahead], a, b - a)
    return np.asarray(ahead[~hidden])


def _crosses(eye: FloatArray, d: FloatArray, a: FloatArray, along: FloatArray) -> np.ndarray:
    """(n,) whether the ways from the eye by d (n, 2) cross the wall before their ends."""
    det = d[:, 0] * -along[1] + d[:, 1] * along[0]
    det = np.where(np.abs(det) < 1e-12, 1e-12, det)
    to = a - eye
    s = (to[0] * -along[1] + to[1] * along[0]) / det
    t = (d[:, 0] * to[1] - d[:, 1] * to[0]) / det
    return np.asarray((s > 1e-6) & (s < 0.97) & (t >= 0) & (t <= 1))
