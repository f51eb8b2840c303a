"""Puts a reconstruction into the world of docs/conventions.md: z up, metres, origin and yaw at the first pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shared.calibration import Calibration
from shared.geometry import FloatArray, IntArray, se3, sim3, upright
from station.model.frames import DriveSample, ImuBatch
from station.model.navigation import Landmarks, Trajectory
from station.motion.inertial_track import InertialTrack
from station.slam.mapping.assemble import Reconstructed
from station.slam.mapping.pose_alignment import (
    METRIC_SIGMA,
    ScaleEstimate,
    align_to_imu,
    gravity_from_accelerometer,
    gyro_bias_from_rotations,
    spaced,
)
from station.slam.sfm.metric import DRIVE_SYSTEMATIC, fuse_scales, scale_from_drive
from station.slam.sfm.trajectory import all_frames

# An unknown scale is set so that the median landmark is this far from where it was first seen.
ARBITRARY_MEDIAN_DEPTH = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    T_world_cam: FloatArray  # (F, 4, 4)
    landmarks: Landmarks
    trajectory: Trajectory
    is_metric: bool
    is_gravity_aligned: bool
    messages: tuple[str, ...]
    facts: dict[str, Any]  # for navigation.json


@dataclass(frozen=True, slots=True, eq=False)
class _Facts:
    """What the inertial and drive data say of a reconstruction."""

    track: InertialTrack | None
    down: FloatArray | None  # (3,) in the reconstruction's world
    scales: list[ScaleEstimate]
    numbers: dict[str, Any]


def place_in_world(
    model: Reconstructed,
    calibration: Calibration,
    imu: ImuBatch | None,
    drive: list[DriveSample],
    t_frames_ns: IntArray,
) -> Placed:
    """Scale, turn and move a reconstruction into the world, and give every frame a pose."""
    facts = _measure(model, calibration, imu, drive)
    T_cam_body = model.camera.T_cam_body_matrix
    scale = fuse_scales(facts.scales)
    is_metric = scale is not None and scale.sigma_relative <= METRIC_SIGMA
    messages = []
    if scale is not None and not is_metric:
        messages.append(f"the scale is known to {100 * scale.sigma_relative:.0f} % only, so it is called arbitrary")
    factor = scale.scale if scale is not None else ARBITRARY_MEDIAN_DEPTH / _median_depth(model)

    T_model_cam = model.keyframes.T_world_cam.copy()
    T_model_cam[:, :3, 3] *= factor
    T_model_body = T_model_cam @ T_cam_body
    up = -facts.down if facts.down is not None else _guess_up(T_model_cam)
    T_world_model = _first_pose_is_origin(up, T_model_body[0])
    T_world_cam = T_world_model @ T_model_cam
    shift_ns = round(model.camera.time_shift_s * 1e9)  # the body is the IMU: its poses are stamped by the IMU's time
    numbers = facts.numbers | {"scale_factor_sigma": None if scale is None else scale.sigma_relative}
    return Placed(
        T_world_cam=T_world_cam,
        landmarks=model.landmarks.moved(sim3(factor, np.eye(3), np.zeros(3))).moved(T_world_model),
        trajectory=all_frames(
            model.keyframes.t_robot_ns + shift_ns,
            T_world_cam @ T_cam_body,
            t_frames_ns + shift_ns,
            facts.track,
        ),
        is_metric=is_metric,
        is_gravity_aligned=facts.down is not None,
        messages=tuple(messages),
        facts={"scale_and_gravity": numbers},
    )


def _measure(model: Reconstructed, calibration: Calibration, imu: ImuBatch | None, drive: list[DriveSample]) -> _Facts:
    keyframes = model.keyframes
    T_body_cam = model.camera.T_body_cam_matrix
    R_body = keyframes.T_world_cam[:, :3, :3] @ T_body_cam[:3, :3].T
    p_cam = keyframes.T_world_cam[:, :3, 3]
    numbers: dict[str, Any] = {}
    scales: list[ScaleEstimate] = []
    track, down = None, None
    t_imu = keyframes.t_robot_ns + round(model.camera.time_shift_s * 1e9)
    if imu is not None and calibration.imu is not None:
        track, angles = gyro_bias_from_rotations(imu, t_imu, R_body)
        numbers["gyro_bias_rad_s"] = track.gyro_bias.tolist()
        if np.isfinite(angles).any():
            numbers["gyro_camera_median_rad"] = float(np.nanmedian(angles))
        down = gravity_from_accelerometer(track, t_imu, R_body)
        some = spaced(t_imu)
        arm = T_body_cam[:3, 3]
        found = align_to_imu(track, t_imu[some], R_body[some], p_cam[some], arm, calibration.imu, calibration.gravity)
        if found is not None:
            scales.append(found.scale)
            if found.scale.sigma_relative < 0.5:
                down = found.gravity_world / np.linalg.norm(found.gravity_world)
            numbers["accel_bias_m_s2"] = found.accel_bias.tolist()
    from_drive = scale_from_drive(drive, t_imu, R_body, p_cam)
    if model.is_drive_metric:
        from_drive = ScaleEstimate(1.0, DRIVE_SYSTEMATIC, "drive")
    if from_drive is not None:
        scales.append(from_drive)
    for estimate in scales:
        numbers[f"scale_{estimate.source}"] = {"scale": estimate.scale, "sigma": estimate.sigma_relative}
    return _Facts(track, down, scales, numbers)


def _median_depth(model: Reconstructed) -> float:
    first = model.landmarks.first_keyframe()
    seen = first >= 0
    if not seen.any():
        return ARBITRARY_MEDIAN_DEPTH
    away = model.landmarks.p_world[seen] - model.keyframes.T_world_cam[first[seen], :3, 3]
    return max(float(np.median(np.linalg.norm(away, axis=1))), 1e-9)


def _guess_up(T_world_cam: FloatArray) -> FloatArray:
    """Cameras are mostly held upright: the mean of their upward axes."""
    up = -T_world_cam[:, :3, 1].sum(axis=0)
    length = float(np.linalg.norm(up))
    return up / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])


def _first_pose_is_origin(up: FloatArray, T_model_body: FloatArray) -> FloatArray:
    """T_world_model (4, 4): z along up, origin at the first body pose, its forward axis (x) at yaw 0."""
    R_world_model = upright(up, T_model_body[:3, :3])
    return se3(R_world_model, -R_world_model @ T_model_body[:3, 3])
