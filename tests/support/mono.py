"""A hand-held camera with known truth for the mono backend: a path, points or pictures along it, and how to judge."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import msgspec
import numpy as np

from robot.simulation.atlas import default_cache_dir
from robot.simulation.body import MotionState
from robot.simulation.config import SimulationConfig
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.trajectory import MotionHistory
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_CAMERA, Calibration
from shared.geometry import FloatArray, IntArray, se3, so3_exp, so3_log
from station.model.frames import ImageFrame
from station.model.navigation import Trajectory
from station.slam.mono.motion import POSE, POSITION
from station.slam.mono.state import Expected, State
from station.vision.lens import BoolArray, Lens

RATE_HZ = 30.0
FRONT_M, FAR_M = 0.3, 25.0  # what is nearer or farther is not seen
NUM_FOLLOWED = 40  # points
GATE = 9.0  # (3 sigma)^2: the backend searches no further
# Looking along x: a camera's x is to the right, its y down.
R_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
NUM_GAUGE = 1  # of a pose seen from the first one, only the scale is free
NEES_DEGREES = 6 - NUM_GAUGE


def hand_held_camera() -> Calibration:
    """A lens of 70 degrees with a global shutter: what MonoSLAM was made for."""
    camera = msgspec.structs.replace(
        REFERENCE_CAMERA, fx=458.0, fy=457.0, distortion=(-0.28, 0.07, 0.0, 0.0), line_delay_s=0.0, time_shift_s=0.0,
        T_body_cam=tuple(np.eye(4).ravel().tolist()),
    )  # fmt: skip
    return Calibration(camera=camera, imu=None, rig="hand-held")


def hand_held_path(seed: int, duration_s: float) -> Trajectory:
    """A person stands and moves a camera about: 30 poses a second, around the origin, looking along x on the whole.

    Each of the six degrees is a sum of two sines of 0.05 to 0.35 Hz: up to 0.5 m to each side and ahead, half of it in
    height, 35 degrees to each side, 12 up and down, 6 of roll.
    """
    rng = np.random.default_rng([seed, 31])
    t = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    reach = np.array([0.5, 0.5, 0.25, np.radians(6), np.radians(12), np.radians(35)])
    share = rng.uniform(0.3, 0.7, 6)
    amplitude = reach[:, None] * np.stack([share, 1.0 - share], axis=1)
    turn = 2.0 * np.pi * rng.uniform(0.05, 0.35, (6, 2))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 2))
    x = (amplitude * np.sin(turn * t[:, None, None] + phase)).sum(axis=2)  # (N, 6)
    zero = np.zeros_like(t)
    yaw, pitch, roll = (so3_exp(np.insert(np.stack([zero, zero], 1), axis, x[:, 3 + axis], 1)) for axis in (2, 1, 0))
    R = yaw @ pitch @ roll @ R_LEVEL
    T = np.stack([se3(R[i], x[i, :3]) for i in range(len(t))])
    return Trajectory(np.rint(t * 1e9).astype(np.int64), T)


class PointFinder:
    """Projected points instead of pictures; a `Finder`. Each measurement has its own noise."""

    def __init__(self, lens: Lens, points: FloatArray, sigma_px: float, seed: int, outliers: float = 0.0) -> None:
        self._lens, self._points = lens, points
        self._sigma_px, self._outliers = sigma_px, outliers
        self._rng = np.random.default_rng([seed, 32])
        self._point_of: dict[int, int] = {}

    def look_from(self, T_world_cam: FloatArray) -> None:
        p = (self._points - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
        front = (p[:, 2] > FRONT_M) & (p[:, 2] < FAR_M)
        xy = p[:, :2] / np.where(front, p[:, 2], 1.0)[:, None]
        front &= np.abs(xy).max(axis=1) < 1.0
        uv = self._lens.project(np.where(front[:, None], xy, 0.0))
        self._visible = front & self._lens.is_inside(uv, 12.0)
        self._uv = uv + self._rng.normal(0.0, self._sigma_px, uv.shape)
        wrong = self._rng.uniform(size=len(uv)) < self._outliers
        self._uv[wrong] += self._rng.normal(0.0, 15.0, (int(wrong.sum()), 2))

    def find(self, state: State, expected: Expected) -> tuple[FloatArray, BoolArray]:
        point = np.array([self._point_of[i] for i in state.ids[expected.rows].tolist()], dtype=np.int64)
        uv = self._uv[point]
        off = uv - expected.uv_px
        chi2 = np.einsum("mi,mij,mj->m", off, np.linalg.inv(expected.ellipses()), off)
        return uv, self._visible[point] & (chi2 < GATE)

    def new_features(self, state: State, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        known = list(self._point_of.values())
        free = self._rng.permutation(np.setdiff1d(np.flatnonzero(self._visible), known))
        taken = list(state.in_view(self._lens)[1])
        kept: list[int] = []
        for i in free.tolist():
            if len(taken) < NUM_FOLLOWED and all(np.abs(self._uv[i] - uv).max() > 20.0 for uv in taken):
                kept.append(i)
                taken.append(self._uv[i])
        kept = kept[: len(ids)]
        self._point_of |= dict(zip(ids.tolist(), kept, strict=False))
        return self._uv[np.array(kept, dtype=np.int64)], np.tile(np.eye(2), (len(kept), 1, 1))


def rendered(path: Trajectory, calibration: Calibration, seed: int) -> Iterator[ImageFrame]:
    """Pictures along a path through the middle of a furnished room, with a camera's blur, noise, exposure and JPEG."""
    assert calibration.camera is not None
    cv2.setNumThreads(1)
    config, world = SimulationConfig(), make_world("room", seed)
    middle = np.array([*world.rooms[0].centre, 1.3])
    t_s, p = path.t_robot_ns * 1e-9, path.T_world_body[:, :3, 3] + middle
    v = np.gradient(p, t_s, axis=0)
    still = np.zeros(3)
    history = MotionHistory(
        MotionState(float(t_s[i]), p[i], path.T_world_body[i, :3, :3], v[i], still, still) for i in range(len(p))
    )
    camera = SimulatedCamera(
        Renderer(world, calibration.camera, default_cache_dir()), calibration.camera, config.camera, seed
    )
    for k, t in enumerate(t_s.tolist()):
        exposure = camera.expose(history.pose, t, config.faults)
        yield ImageFrame(k, int(path.t_robot_ns[k]), round(exposure.exposure_s * 1e9), exposure.jpeg)


def pose_nees(state: State, T_first_cam: FloatArray) -> float:
    """How far the pose is off for what the filter believes: chi-square of NEES_DEGREES where it is right.

    Position and attitude as seen from the first camera, with the scale that fits best at this moment: scale is nobody's
    to know, and projected out it takes one degree with it. T_first_cam (4, 4): the truth.
    """
    P = state.P[:POSE, :POSE]
    error = np.concatenate([state.x[POSITION], so3_log(T_first_cam[:3, :3].T @ state.R)])
    free = np.concatenate([T_first_cam[:3, 3], np.zeros(3)])
    information = np.linalg.inv(P)
    error = error - free * float(free @ information @ error) / float(free @ information @ free)
    return float(error @ information @ error)
