"""A room of four walls, floor and ceiling: what a camera and a depth sensor on one body see of it, and its map."""

from __future__ import annotations

import cv2
import msgspec
import numpy as np

from shared.calibration import REFERENCE_CAMERA, Calibration, DepthCalibration
from shared.geometry import FloatArray, carry_poses, inverse, se3, sim3, transform, yaw_rotation
from station.model.frames import DepthArray, DepthFrame, DriveSample, ImageArray, ImageFrame, ImuBatch
from station.model.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.model.slam_update import SlamUpdate
from station.slam.mapping.depth import DepthLog, with_depth

LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([5.0, 4.0, 2.5])  # m
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # a sensor that looks along the body's x axis
STEP_NS = 50_000_000
CAMERA = msgspec.structs.replace(
    REFERENCE_CAMERA,
    fx=400.0,
    fy=400.0,
    cx=319.5,
    cy=239.5,
    distortion=(0.0,) * 4,
    T_body_cam=tuple(se3(FORWARD, np.array([0.1, 0.0, 0.0])).ravel().tolist()),
    time_shift_s=0.0,
    line_delay_s=0.0,
)


def depth_camera(width: int = 160, height: int = 120, aside_m: float = 0.05) -> DepthCalibration:
    return DepthCalibration(
        width=width,
        height=height,
        fx=0.9 * width,
        fy=0.9 * width,
        cx=(width - 1) / 2,
        cy=(height - 1) / 2,
        T_body_depth=tuple(se3(FORWARD, np.array([0.1, aside_m, 0.0])).ravel().tolist()),
    )


def measured(sensor: DepthCalibration, T_world_body: FloatArray) -> DepthArray:
    """(H, W) mm from inside the room, without noise."""
    T = T_world_body @ sensor.T_body_depth_matrix
    v, u = np.mgrid[0 : sensor.height, 0 : sensor.width]
    rays = np.stack([(u - sensor.cx) / sensor.fx, (v - sensor.cy) / sensor.fy, np.ones(u.shape)], axis=-1)
    return np.round(1000 * _reach(T[:3, 3], rays @ T[:3, :3].T)).astype(np.uint16)


def _reach(origin: FloatArray, direction: FloatArray) -> FloatArray:
    """How many times a direction (..., 3) fits between an origin (3,) and the room's surface."""
    with np.errstate(divide="ignore"):
        return np.where(direction > 0, (HIGH - origin) / direction, (LOW - origin) / direction).min(axis=-1)


def encoded(millimetres: DepthArray | ImageArray) -> bytes:
    return cv2.imencode(".png", millimetres)[1].tobytes()


def way(count: int = 40) -> FloatArray:
    """(count, 4, 4) T_world_body along the middle of the room, looking about."""
    x, yaw = np.linspace(1.0, 3.5, count), np.linspace(-1.2, 1.6, count)
    return np.stack([se3(yaw_rotation(a), np.array([b, 1.5, 0.8])) for a, b in zip(yaw, x, strict=True)])


def frames(sensor: DepthCalibration, T_world_body: FloatArray, every: int = 2) -> list[DepthFrame]:
    return [
        DepthFrame(k * STEP_NS, encoded(measured(sensor, T_world_body[k])), sensor)
        for k in range(0, len(T_world_body), every)
    ]


def map_of(T_world_body: FloatArray, unit_m: float = 1.0, seed: int = 0) -> Navigation:
    """What SLAM by images makes of that way: landmarks on all surfaces, all lengths in units of so many metres."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(1500, 3))
    middle = 0.5 * (LOW + HIGH)
    p = middle + direction * _reach(middle, direction)[:, None]
    T_cam = T_world_body @ CAMERA.T_body_cam_matrix
    landmark, keyframe, uv = [], [], []
    for k, T in enumerate(T_cam):
        q = transform(inverse(T), p)
        pixel = CAMERA.fx * q[:, :2] / q[:, 2:] + [CAMERA.cx, CAMERA.cy]
        seen = np.flatnonzero((q[:, 2] > 0.1) & (pixel > 0).all(axis=1) & (pixel < [640, 480]).all(axis=1))
        landmark.append(seen)
        keyframe.append(np.full(len(seen), k))
        uv.append(pixel[seen])
    S = sim3(1.0 / unit_m, np.eye(3), np.zeros(3))
    t = np.arange(len(T_cam)) * STEP_NS
    return Navigation(
        id="room",
        calibration=Calibration(camera=CAMERA, imu=None),
        trajectory=Trajectory(t, carry_poses(S, T_world_body)),
        keyframes=Keyframes(
            np.arange(len(t)), t, carry_poses(S, T_cam), (b"",) * len(t), np.zeros(len(t), dtype=np.int64)
        ),
        landmarks=Landmarks(
            p / unit_m,
            np.full(p.shape, 128, dtype=np.uint8),
            np.zeros((len(p), 3, 3)),
            np.concatenate(landmark),
            np.concatenate(keyframe),
            np.concatenate(uv),
        ),
        report=NavigationReport(
            "sfm", len(t), 1.0, 1.0, 1.0, 1.0, len(p), 0.0, "metric" if unit_m == 1.0 else "arbitrary", True, 0, {}, {}
        ),
    )


def scanned(navigation: Navigation, sensor: DepthCalibration, T_world_body: FloatArray) -> Navigation:
    """The map with what the sensor measured on that way."""
    log = DepthLog()
    for frame in frames(sensor, T_world_body):
        log.add(frame)
    return with_depth(navigation, log)


class Made:
    """A backend that has its map already."""

    def __init__(self, navigation: Navigation) -> None:
        self.navigation = navigation
        self.order: list[object] = []

    def add_imu(self, imu: ImuBatch) -> None:
        self.order.append(imu)

    def add_drive(self, drive: DriveSample) -> None:
        self.order.append(drive)

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        self.order.append(frame)
        return SlamUpdate(frame.t_robot_ns, "tracking", "", None, 0, False)

    def catch_up(self) -> bool:
        return False

    def keyframe_pictures(self) -> list[bytes]:
        return []

    def keyframe_features(self, number: int) -> None: ...

    def finish(self) -> Navigation:
        return self.navigation


def half_sized_room(_calibration: Calibration) -> Made:
    """A backend by name: the room in units of half a metre."""
    return Made(map_of(way(), 0.5))
