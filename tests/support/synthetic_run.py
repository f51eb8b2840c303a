"""Synthetic visual-inertial runs with known truth: consistency studies, and real inertial data without images.

A room of point landmarks is projected along a true path with pixel noise. The path and IMU are either analytic (sines)
or a dataset's own. Judges only: what an estimator may see is the IMU and the tracked features.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import Calibration
from shared.geometry import FloatArray, IntArray, se3, so3_exp, so3_log
from station.model.frames import ImageFrame, ImuBatch
from station.motion.imu_buffer import ImuBuffer
from station.motion.preintegration import preintegrate
from station.slam.ukf.map.keyframes import Keyframe
from station.vision.klt import TrackedFrame
from station.vision.lens import Lens


@dataclass(frozen=True, slots=True, eq=False)
class TruePath:
    """States at the camera's times."""

    t_ns: IntArray  # (N,)
    R_world_body: FloatArray  # (N, 3, 3)
    x_world: FloatArray  # (N, 3)
    v_world: FloatArray  # (N, 3)
    omega_body: FloatArray  # (N, 3) rad/s
    bias_gyro: FloatArray  # (N, 3)
    bias_accel: FloatArray  # (N, 3)


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticRun:
    calibration: Calibration
    imu: ImuBatch
    truth: TruePath
    points: FloatArray  # (P, 3) world
    frames: tuple[TrackedFrame, ...]


def sine_path(
    calibration: Calibration, seed: int, duration_s: float, frame_rate_hz: float = 20.0
) -> tuple[ImuBatch, TruePath]:
    """A smooth hand-held walk around the origin, with IMU noise and drifting biases as the calibration says."""
    noise = calibration.imu
    assert noise is not None
    rng = np.random.default_rng(seed)
    dt = 1.0 / noise.rate_hz
    t = np.arange(round(duration_s / dt) + 1) * dt
    amplitude = rng.uniform(0.3, 0.9, (3, 2)) * np.array([[1.0], [1.0], [0.4]])
    w = 2.0 * np.pi * rng.uniform(0.08, 0.35, (3, 2))
    shift = rng.uniform(0, 2 * np.pi, (3, 2))
    angle = w[None] * t[:, None, None] + shift
    x = (amplitude * np.sin(angle)).sum(axis=2)
    v = (amplitude * w * np.cos(angle)).sum(axis=2)
    a = (-amplitude * w * w * np.sin(angle)).sum(axis=2)
    turn = np.stack(
        [
            0.2 * np.sin(2 * np.pi * 0.31 * t + rng.uniform(0, 6)),
            0.2 * np.sin(2 * np.pi * 0.23 * t + rng.uniform(0, 6)),
            0.25 * t * rng.choice([-1.0, 1.0]) + 0.5 * np.sin(2 * np.pi * 0.15 * t + rng.uniform(0, 6)),
        ],
        axis=1,
    )
    zero = np.zeros_like(t)
    yaw = so3_exp(np.stack([zero, zero, turn[:, 2]], axis=1))
    R = yaw @ so3_exp(np.stack([turn[:, 0], turn[:, 1], zero], axis=1))
    h = 1e-5  # angular rate by a central difference of the same formula
    rate = np.empty_like(turn)
    derivative = np.gradient(turn, dt, axis=0, edge_order=2)
    ahead, behind = turn + h * derivative, turn - h * derivative
    for sign, values in ((1, ahead), (-1, behind)):
        part = so3_exp(np.stack([zero, zero, values[:, 2]], axis=1))
        part = part @ so3_exp(np.stack([values[:, 0], values[:, 1], zero], axis=1))
        step = so3_log(np.swapaxes(R, 1, 2) @ part) * (sign / (2 * h))
        rate = step if sign == 1 else rate + step
    bias_gyro = rng.normal(0, 0.01, 3) + np.cumsum(rng.normal(0, noise.gyro_walk * np.sqrt(dt), x.shape), axis=0)
    bias_accel = rng.normal(0, 0.05, 3) + np.cumsum(rng.normal(0, noise.accel_walk * np.sqrt(dt), x.shape), axis=0)
    force = np.einsum("nji,nj->ni", R, a + np.array([0.0, 0.0, calibration.gravity]))
    gyro = rate + bias_gyro + rng.normal(0, noise.gyro_density / np.sqrt(dt), x.shape)
    accel = force + bias_accel + rng.normal(0, noise.accel_density / np.sqrt(dt), x.shape)
    t_ns = np.rint(t * 1e9).astype(np.int64)
    every = round(1.0 / (frame_rate_hz * dt))
    pick = slice(0, None, every)
    truth = TruePath(t_ns[pick], R[pick], x[pick], v[pick], rate[pick], bias_gyro[pick], bias_accel[pick])
    return ImuBatch(t_ns, gyro, accel), truth


def room_points(path: FloatArray, seed: int, count: int = 1200, margin_m: float = 2.0) -> FloatArray:
    """Points (count, 3) on the walls, floor and ceiling of a box around the path, some of them standing inside."""
    rng = np.random.default_rng([seed, 1])
    low, high = path.min(axis=0) - margin_m, path.max(axis=0) + margin_m
    points = rng.uniform(low, high, (count, 3))
    face = rng.integers(0, 6, count)
    depth = rng.uniform(0.0, 0.5, count) * margin_m * 0.8
    axis = face % 3
    near_low = face < 3
    points[np.arange(count), axis] = np.where(near_low, low[axis] + depth, high[axis] - depth)
    return points


def observe(
    calibration: Calibration,
    truth: TruePath,
    points: FloatArray,
    sigma_px: float,
    seed: int,
    num_features: int = 150,
    loss: float = 0.01,
    outliers: float = 0.0,
) -> tuple[TrackedFrame, ...]:
    """Tracked features frame by frame: a point keeps its id while it stays in view and is not lost by chance."""
    camera = calibration.camera
    assert camera is not None
    lens, T = Lens(camera), camera.T_body_cam_matrix
    rng = np.random.default_rng([seed, 2])
    alive = np.zeros(len(points), dtype=bool)
    ids = np.full(len(points), -1, dtype=np.int64)
    next_id, frames = 0, []
    for k in range(len(truth.t_ns)):
        p_cam = ((points - truth.x_world[k]) @ truth.R_world_body[k] - T[:3, 3]) @ T[:3, :3]
        z = p_cam[:, 2]
        front = (z > 0.3) & (z < 25.0)
        xy = p_cam[:, :2] / np.where(front, z, 1.0)[:, None]
        near_axis = np.abs(xy).max(axis=1) < 1.2
        uv = lens.project(np.where(near_axis[:, None], xy, 0.0))
        visible = front & near_axis & lens.is_inside(uv, 5.0)
        alive &= visible & (rng.uniform(size=len(points)) > loss)
        tracked = int(alive.sum())
        fresh = np.flatnonzero(visible & ~alive)
        fresh = rng.permutation(fresh)[: max(0, num_features - tracked)]
        ids[fresh] = np.arange(next_id, next_id + len(fresh))
        next_id += len(fresh)
        alive[fresh] = True
        index = np.flatnonzero(alive)
        index = index[np.argsort(ids[index])]
        measured = uv[index] + rng.normal(0, sigma_px, (len(index), 2))
        wrong = rng.uniform(size=len(index)) < outliers
        measured[wrong] += rng.normal(0, 15.0, (int(wrong.sum()), 2))
        frames.append(
            TrackedFrame(
                ids=ids[index].copy(),
                uv_px=measured,
                xy=lens.unproject(measured),
                num_tracked=tracked,
                brightness=100.0,
            )
        )
    return tuple(frames)


def true_keyframes(
    calibration: Calibration,
    told: Calibration,
    seed: int,
    duration_s: float,
    sigma_px: float,
    outliers: float = 0.0,
    rate_hz: float = 20.0,
) -> list[Keyframe]:
    """A synthetic run as keyframes at its true poses; features are undistorted with the told calibration.

    A camera that is told to be mounted or timed otherwise sees the same: only what is made of it differs.
    """
    assert calibration.imu is not None and told.camera is not None
    imu, truth = sine_path(calibration, seed, duration_s, rate_hz)
    frames = observe(calibration, truth, room_points(truth.x_world, seed), sigma_px, seed, outliers=outliers)
    buffer = ImuBuffer(calibration.imu, keep_s=duration_s + 1.0)
    buffer.add(imu)
    lens = Lens(told.camera)
    shift_ns = round(1e9 * told.camera.time_shift_s)
    first_ns, last_ns = int(imu.t_robot_ns[0]), int(imu.t_robot_ns[-1])
    keyframes: list[Keyframe] = []
    for k, frame in enumerate(frames):
        t_ns = int(truth.t_ns[k]) + shift_ns
        if not first_ns <= t_ns <= last_ns:
            continue
        bias = np.concatenate([truth.bias_gyro[k], truth.bias_accel[k]])
        before = keyframes[-1].image.t_robot_ns + shift_ns if keyframes else None
        keyframes.append(
            Keyframe(
                image=ImageFrame(k, int(truth.t_ns[k]), 0, b""),
                tracked=replace(frame, xy=lens.unproject(frame.uv_px)),
                rgb=np.zeros((len(frame.ids), 3), dtype=np.uint8),
                T_world_head=se3(truth.R_world_body[k], truth.x_world[k]),
                v_world=truth.v_world[k],
                omega_head=truth.omega_body[k],
                bias=bias,
                segment=0,
                link=None if before is None else preintegrate(buffer.segment(before, t_ns), bias, calibration.imu),
                wheels=None,
            )
        )
    return keyframes
