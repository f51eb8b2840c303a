"""Landmarks of rooms with a door, without pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.calibration import Calibration, CameraCalibration
from shared.geometry import FloatArray, se3, yaw_rotation
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.place_map import PlaceMap
from tests.support.places import R_BODY_CAM, make_map

WALL_X, DOOR = 4.0, (1.6, 2.4)  # between the room (x 0..4, y 0..4) and its neighbour (x 4..8)
HALF_VIEW = np.arctan(320 / 1080)  # as narrow as the robot's camera


CAMERA = CameraCalibration(
    width=640,
    height=480,
    fx=1080,
    fy=1080,
    cx=320,
    cy=240,
    T_body_cam=tuple(se3(R_BODY_CAM, np.zeros(3)).ravel().tolist()),
)


def mapped(xy: FloatArray, yaw: FloatArray, p: FloatArray, *, upright: bool = True) -> PlaceMap:
    """A map of keyframes at xy (F, 2) that look along yaw (F,) and saw what of p (M, 3) the wall does not hide."""
    T = np.stack([se3(yaw_rotation(a), np.array([*q, 0.0])) for q, a in zip(xy, yaw, strict=True)])
    observed = [(m, k) for k in range(len(xy)) for m in np.flatnonzero(_in_view(xy[k], yaw[k], p))]
    landmark, keyframe = np.array(observed, dtype=np.int64).reshape(-1, 2).T
    count, t = len(p), np.arange(len(xy)) * 10**9
    T_cam, zeros, uv_px = (
        T @ se3(R_BODY_CAM, np.zeros(3)),
        np.zeros(len(xy), dtype=np.int64),
        np.zeros((len(landmark), 2)),
    )
    navigation = Navigation(
        id="nav",
        calibration=Calibration(camera=CAMERA, imu=None, rig="wheels"),
        trajectory=Trajectory(t, T),
        keyframes=Keyframes(np.arange(len(t)), t, T_cam, (b"",) * len(t), zeros),
        landmarks=Landmarks(p, np.zeros((count, 3), np.uint8), np.zeros((count, 3, 3)), landmark, keyframe, uv_px),
        report=NavigationReport("test", len(t), 1, 1, 1, 1, count, 0, "metric", upright, 0, {}, {}),
    )
    return replace(make_map(places=1), navigation=navigation)


def walls() -> FloatArray:
    """Landmarks (M, 3) on all walls of both rooms, every 5 cm, at three heights; none in the door."""
    along = np.arange(0.0, 4.0, 0.025)
    lines = []
    for x0, sides in ((0.0, (0.0, 3.98)), (4.02, (4.02, 8.0))):
        lines += [np.column_stack([x0 + along, np.full_like(along, y)]) for y in (0.0, 4.0)]
        lines += [np.column_stack([np.full_like(along, x), along]) for x in sides]
    xy = np.concatenate(lines)
    in_door = (np.abs(xy[:, 0] - WALL_X) < 0.1) & (xy[:, 1] > DOOR[0]) & (xy[:, 1] < DOOR[1])
    xy = xy[~in_door]
    return np.concatenate([np.column_stack([xy, np.full(len(xy), z)]) for z in (-0.2, 0.2, 0.6)])


def room_with_a_door(*, upright: bool = True) -> PlaceMap:
    """A ring through the room, looking everywhere, and up to its door."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = 2.0 + 1.2 * np.column_stack([np.cos(angle), np.sin(angle)])
    to_door = np.column_stack([np.linspace(3.2, 3.9, 4), np.full(4, 2.0)])
    return mapped(np.concatenate([ring, to_door]), np.concatenate([5 * angle, np.zeros(4)]), walls(), upright=upright)


def _in_view(xy: FloatArray, yaw: float, p: FloatArray) -> np.ndarray:
    d = p[:, :2] - xy
    ahead = np.abs((np.arctan2(d[:, 1], d[:, 0]) - yaw + np.pi) % (2 * np.pi) - np.pi) < HALF_VIEW
    beyond = p[:, 0] > WALL_X
    y = xy[1] + d[:, 1] * (WALL_X - xy[0]) / np.where(beyond, d[:, 0], 1.0)  # where the ray crosses the wall
    return ahead & (~beyond | ((y > DOOR[0]) & (y < DOOR[1])))
