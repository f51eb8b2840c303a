"""A camera with an IMU waved before a target: what its detector and its IMU would give, with the truth beside it.

The motion is a sum of sines, which no spline holds exactly; each corner is seen at the exposure of its own row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np

from shared.calibration import REFERENCE_CAMERA, REFERENCE_IMU, CameraCalibration, ImuNoise
from shared.geometry import FloatArray, se3, so3_exp, so3_log
from station.calibration.target import BoardView, Target
from station.model.frames import ImuBatch
from station.vision.lens import BoolArray, Lens

ORIGIN_NS = 5_000_000_000_000
IMU_MARGIN_S = 0.5  # the IMU begins before the first image and ends after the last
DIFFERENCE_S = 1e-4
FACING = np.diag([1.0, -1.0, -1.0])  # R_target_cam of a camera straight before an AprilGrid, whose y points up
TARGET = Target("aprilgrid", columns=6, rows=6, square_m=0.024, gap_m=0.0072)


@dataclass(frozen=True, slots=True)
class Waving:
    """How somebody moves the robot; the amplitudes are of each of three or four sines."""

    turn_rad: tuple[float, float, float] = (0.12, 0.12, 0.2)  # about the camera's axes
    shake_m: float = 0.015
    distance_m: float = 0.6
    distance_swing_m: float = 0.04
    slowest_hz: float = 0.2
    fastest_hz: float = 1.2
    sines: int = 4


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    views: list[BoardView]
    imu: ImuBatch
    target: Target
    camera: CameraCalibration  # the true one
    noise: ImuNoise
    gravity_target: FloatArray  # (3,) m/s^2

    def told(self) -> CameraCalibration:
        """What is known before: intrinsics, not how the camera is mounted, timed and read out."""
        return msgspec.structs.replace(
            self.camera, T_body_cam=tuple(np.eye(4).ravel().tolist()), time_shift_s=0.0, line_delay_s=0.0
        )


class _Sines:
    """Sums of sines (N, width) of time."""

    def __init__(self, rng: np.random.Generator, waving: Waving, amplitudes: FloatArray) -> None:
        shape = (waving.sines, len(amplitudes))
        self._rate = 2 * np.pi * rng.uniform(waving.slowest_hz, waving.fastest_hz, shape)
        self._phase = rng.uniform(0, 2 * np.pi, shape)
        self._amplitude = amplitudes * rng.uniform(0.7, 1.3, shape)

    def __call__(self, t: FloatArray) -> FloatArray:
        angle = t[:, None, None] * self._rate + self._phase
        return np.asarray((self._amplitude * np.sin(angle)).sum(axis=1))


class HandheldMotion:
    def __init__(self, rng: np.random.Generator, waving: Waving, target: Target, T_body_cam: FloatArray) -> None:
        self._turn = _Sines(rng, waving, np.array(waving.turn_rad))
        self._shake = _Sines(rng, waving, np.full(3, waving.shake_m))
        self._swing = _Sines(rng, waving, np.array([waving.distance_swing_m]))
        self._waving, self._T_body_cam = waving, T_body_cam
        self._middle = 0.5 * (target.corners.min(axis=0) + target.corners.max(axis=0))

    def body(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """R_target_body (N, 3, 3), p_target_body (N, 3)."""
        R_cam = FACING @ so3_exp(self._turn(t))
        distance = self._waving.distance_m + self._swing(t)
        p_cam = self._middle - R_cam[:, :, 2] * distance + self._shake(t)
        R = R_cam @ self._T_body_cam[:3, :3].T
        return R, p_cam - R @ self._T_body_cam[:3, 3]

    def readings(self, t: FloatArray, gravity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What a perfect gyroscope (N, 3) and accelerometer (N, 3) would read."""
        h = DIFFERENCE_S
        (R_before, p_before), (R, p), (R_after, p_after) = (self.body(t + s) for s in (-h, 0.0, h))
        gyro = so3_log(np.swapaxes(R_before, 1, 2) @ R_after) / (2 * h)
        a = (p_after - 2 * p + p_before) / (h * h)
        return gyro, (np.swapaxes(R, 1, 2) @ (a - gravity)[..., None])[..., 0]


def make_session(
    seed: int,
    duration_s: float = 30.0,
    frame_rate_hz: float = 10.0,
    imu_rate_hz: float = 200.0,
    corner_noise_px: float = 0.3,
    waving: Waving | None = None,
    camera: CameraCalibration | None = None,
    noise: ImuNoise = REFERENCE_IMU,
    target: Target = TARGET,
    made: Target | None = None,
) -> Session:
    """A recording by a robot whose camera is mounted as no other's.

    Args:
        camera: by default near the reference robot's, drawn by the seed.
        target: what its file says; `made` is the one that was really printed.
    """
    rng = np.random.default_rng(seed)
    camera = camera or drawn_camera(rng)
    motion = HandheldMotion(rng, waving or Waving(), made or target, camera.T_body_cam_matrix)
    up = so3_exp(rng.normal(0.0, 0.1, 3)) @ np.array([0.0, 1.0, 0.0])
    gravity = -9.81 * up
    t = np.arange(-IMU_MARGIN_S, duration_s + IMU_MARGIN_S, 1 / imu_rate_hz)
    gyro, accel = motion.readings(t, gravity)
    for reading, density, walk, bias in (
        (gyro, noise.gyro_density, noise.gyro_walk, 0.01),
        (accel, noise.accel_density, noise.accel_walk, 0.05),
    ):
        reading += rng.normal(0.0, density * np.sqrt(imu_rate_hz), reading.shape)
        reading += rng.normal(0.0, bias, 3)
        reading += np.cumsum(rng.normal(0.0, walk / np.sqrt(imu_rate_hz), reading.shape), axis=0)
    times = np.arange(0.0, duration_s, 1 / frame_rate_hz) - camera.time_shift_s
    times = times[(times > 0.0) & (times < duration_s)]
    views = _views(rng, times, camera, motion, made or target, corner_noise_px)
    imu = ImuBatch(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), gyro, accel)
    return Session(views, imu, target, camera, noise, gravity)


def drawn_camera(rng: np.random.Generator) -> CameraCalibration:
    T = REFERENCE_CAMERA.T_body_cam_matrix
    T = se3(T[:3, :3] @ so3_exp(rng.normal(0.0, 0.15, 3)), T[:3, 3] + rng.normal(0.0, 0.03, 3))
    return msgspec.structs.replace(
        REFERENCE_CAMERA,
        T_body_cam=tuple(T.ravel().tolist()),
        fx=640.0,
        fy=640.0,
        distortion=(-0.3, 0.1, 0.0, 0.0),
        line_delay_s=float(rng.uniform(15e-6, 45e-6)),
    )


def _views(
    rng: np.random.Generator,
    times: FloatArray,
    camera: CameraCalibration,
    motion: HandheldMotion,
    target: Target,
    noise_px: float,
) -> list[BoardView]:
    uv, seen = exposed(times, camera, motion, target.corners)
    uv = uv + rng.normal(0.0, noise_px, uv.shape)
    views = []
    for time, places, in_view in zip(times, uv, seen, strict=True):
        stamp = ORIGIN_NS + round(1e9 * time)
        views.append(BoardView(f"{stamp}.png", stamp, np.flatnonzero(in_view), places[in_view]))
    return [view for view in views if len(view.ids) >= 8]


def exposed(
    times: FloatArray, camera: CameraCalibration, motion: HandheldMotion, points: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Where images at times (K,), camera clock, show points (P, 3) of the target's frame: (K, P, 2) px, and whether."""
    lens, T = Lens(camera), camera.T_body_cam_matrix
    which = np.tile(np.arange(len(points)), len(times))
    t = np.repeat(times, len(points))
    v = np.full(len(t), 0.5 * camera.height)
    for _ in range(6):  # each point is seen by the row that is exposed when it lies there
        R, p = motion.body(t + camera.time_shift_s + camera.line_delay_s * v)
        p_body = (np.swapaxes(R, 1, 2) @ (points[which] - p)[..., None])[..., 0]
        p_cam = (p_body - T[:3, 3]) @ T[:3, :3]
        uv = lens.project(p_cam[:, :2] / p_cam[:, 2:])
        v = uv[:, 1]
    seen = lens.is_inside(uv, 5.0) & (p_cam[:, 2] > 0.05)
    shape = (len(times), len(points))
    return uv.reshape(*shape, 2), seen.reshape(shape)


def without(session: Session, first: int, last: int) -> Session:
    """The target out of sight in the views first .. last - 1."""
    return replace(session, views=session.views[:first] + session.views[last:])
