"""Refining the keyframes when the drive has ended."""

from __future__ import annotations

import itertools
from dataclasses import replace

import msgspec
import numpy as np

from shared.calibration import REFERENCE_CAMERA, Calibration, ImuNoise
from shared.geometry import FloatArray, inverse, se3, so3_exp, so3_log
from station.experiments.trajectory_error import relative_pose_error
from station.model.navigation import Trajectory
from station.slam.ukf.map.keyframes import Keyframe
from station.slam.ukf.map.pose_log import PoseLog, follow_poses
from station.slam.ukf.map.refine import refine_segment
from station.vision.camera_model import CameraModel
from tests.support.synthetic_run import true_keyframes

NOISE = ImuNoise(gyro_density=1.7e-4, accel_density=2e-3, gyro_walk=2e-5, accel_walk=3e-3, rate_hz=200.0)
CAMERA = msgspec.structs.replace(REFERENCE_CAMERA, fx=458.0, fy=457.0, line_delay_s=0.0, time_shift_s=0.0)
CALIBRATION = Calibration(camera=CAMERA, imu=NOISE)


def drifting_keyframes(seed: int) -> tuple[list[Keyframe], FloatArray]:
    """Six seconds, 20 keyframes per second, poses that sway by 5 cm; and the true poses (K, 4, 4)."""
    true = true_keyframes(CALIBRATION, CALIBRATION, seed, 6.0, 0.5)
    T_true = np.array([k.T_world_head for k in true])
    drift = 0.05 * np.sin(np.arange(len(true))[:, None] * np.array([0.2, 0.23, 0.17]))
    keyframes = [
        replace(k, T_world_head=se3(T[:3, :3], T[:3, 3] + d)) for k, T, d in zip(true, T_true, drift, strict=True)
    ]
    return keyframes, T_true


def test_refined_keyframes_are_nearer_to_the_truth_and_so_are_those_between_them() -> None:
    keyframes, T_true = drifting_keyframes(3)
    camera = CameraModel.of(CAMERA, 1.0)
    refined, messages = refine_segment(keyframes, camera, NOISE, CALIBRATION.gravity)
    assert not messages
    assert [k.image.index for k in refined] == [k.image.index for k in keyframes]
    t = np.array([k.image.t_robot_ns for k in keyframes])

    def error(items: list[Keyframe]) -> float:
        path = Trajectory(t, np.array([k.T_world_head for k in items]))
        return relative_pose_error(path, Trajectory(t, T_true), 0.5).translation_rmse_m

    assert error(refined) < 0.5 * error(keyframes)
    moved = [
        np.linalg.norm(a.T_world_head[:3, 3] - b.T_world_head[:3, 3]) for a, b in zip(keyframes, refined, strict=True)
    ]
    assert min(moved[1:]) > 0.0  # the frames between the chosen ones have followed


def test_poses_between_two_keyframes_blend_their_corrections() -> None:
    rng = np.random.default_rng(1)
    T_old = np.array([se3(so3_exp(rng.normal(size=3)), rng.normal(size=3)) for _ in range(3)])
    correction = np.array([se3(so3_exp(0.1 * rng.normal(size=3)), 0.1 * rng.normal(size=3)) for _ in range(3)])
    T_new = correction @ T_old
    t_key = np.array([10, 20, 40])
    at_keys = follow_poses(T_old, t_key, T_old, T_new, t_key)
    assert np.allclose(at_keys, T_new, atol=1e-12)
    between = np.array([T_old[1]] * 3)
    found = follow_poses(between, np.array([5, 30, 99]), T_old, T_new, t_key)
    assert np.allclose(found[0], correction[0] @ T_old[1])  # before the first: as the first
    assert np.allclose(found[2], correction[2] @ T_old[1])
    a, b = correction[1] @ T_old[1], correction[2] @ T_old[1]
    assert np.allclose(found[1][:3, 3], 0.5 * (a[:3, 3] + b[:3, 3]))
    to_a, to_b = (so3_log((inverse(x) @ found[1])[:3, :3]) for x in (a, b))
    assert np.allclose(to_a, -to_b, atol=1e-9)


def test_a_log_follows_its_keyframes_and_leaves_other_segments_alone() -> None:
    log = PoseLog()
    poses = [se3(np.eye(3), np.array([float(k), 0.0, 0.0])) for k in range(6)]
    for k, T in enumerate(poses):
        log.add(k, 10 * k, T, 0 if k < 4 else 1)
    up = se3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    log.follow([0, 3], np.array([poses[0], poses[3]]), np.array([poses[0], up @ poses[3]]), 0)
    _, T = log.arrays()
    assert np.allclose(T[:, 2, 3], [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0, 0.0, 0.0])
    assert all(np.allclose(a[:3, :3], b[:3, :3]) for a, b in itertools.pairwise(T))
