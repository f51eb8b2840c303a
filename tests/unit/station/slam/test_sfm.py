"""The parts of structure from motion, on small synthetic scenes with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.calibration import REFERENCE_IMU, CameraCalibration, ImuNoise
from shared.geometry import FloatArray, inverse, se3, so3_exp, so3_log, transform, yaw_rotation
from station.experiments.alignment import align_points
from station.model.frames import DriveSample, ImuBatch
from station.motion.dead_reckoning import bias_at_rest
from station.motion.drive_commands import MOTOR_LAG_S
from station.motion.imu_buffer import ImuBuffer
from station.motion.inertial_track import InertialTrack
from station.motion.preintegration import preintegrate
from station.slam.mapping import odometry_bundle
from station.slam.mapping.odometry import DEAD_RECKONED, MOTION_START, Odometry, dead_reckon
from station.slam.mapping.odometry_bundle import BundleState, Observations, adjust, reprojection_errors
from station.slam.mapping.pose_alignment import ScaleEstimate, align_to_imu, gyro_bias_from_rotations
from station.slam.mapping.tracks import build_tracks, longest
from station.slam.sfm.metric import fuse_scales, scale_from_drive
from station.slam.sfm.trajectory import all_frames
from station.vision.triangulation import intersect_rays

GRAVITY = np.array([0.0, 0.0, -9.81])
RATE_HZ = 200


def lively_motion(seconds: float = 12.0) -> tuple[np.ndarray, FloatArray, FloatArray, ImuBatch]:
    """Times (N,) ns, true poses (N, 4, 4), velocities and exact inertial samples of a body that moves a lot."""
    t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    phase = np.column_stack([0.9 * t, 0.7 * t + 1.0, 1.1 * t + 2.0])
    frequency, size = np.array([0.9, 0.7, 1.1]), np.array([1.0, 0.8, 0.3])
    p, v = size * np.sin(phase), size * frequency * np.cos(phase)
    a = -size * frequency**2 * np.sin(phase)
    rate = np.column_stack([0.3 * np.sin(0.5 * t), 0.2 * np.cos(0.8 * t), 0.5 * np.sin(0.3 * t) + 0.2])
    R = np.empty((len(t), 3, 3))
    R[0] = so3_exp(np.array([0.1, -0.2, 0.3]))
    middle = 0.5 * (rate[1:] + rate[:-1]) / RATE_HZ
    for k, step in enumerate(so3_exp(middle)):
        R[k + 1] = R[k] @ step
    accel = np.einsum("nji,nj->ni", R, a - GRAVITY)
    t_ns = np.round(t * 1e9).astype(np.int64)
    poses = np.stack([se3(Rk, pk) for Rk, pk in zip(R, p, strict=True)])
    return t_ns, poses, v, ImuBatch(t_ns, rate, accel)


def test_scale_gravity_and_biases_come_back_from_a_scaled_turned_reconstruction() -> None:
    t, poses, _, exact = lively_motion()
    gyro_bias, accel_bias = np.array([0.01, -0.02, 0.015]), np.array([0.05, -0.1, 0.08])
    imu = ImuBatch(t, exact.gyro_imu + gyro_bias, exact.accel_imu + accel_bias)
    T_body_cam = se3(so3_exp(np.array([0.2, 1.1, -0.4])), np.array([0.19, 0.04, 0.01]))
    true_scale, R_model_world = 2.5, so3_exp(np.array([0.5, -0.7, 0.2]))
    k = np.arange(0, len(t), 100)
    cams = poses[k] @ T_body_cam
    p_model = cams[:, :3, 3] @ R_model_world.T / true_scale
    R_model_body = R_model_world @ poses[k, :3, :3]
    track, angles = gyro_bias_from_rotations(imu, t[k], R_model_body)
    np.testing.assert_allclose(track.gyro_bias, gyro_bias, atol=1e-5)
    assert np.nanmax(angles) < 1e-4
    noise = ImuNoise(gyro_density=1e-4, accel_density=1e-3, gyro_walk=1e-5, accel_walk=1e-4, rate_hz=RATE_HZ)
    found = align_to_imu(track, t[k], R_model_body, p_model, T_body_cam[:3, 3], noise, 9.81)
    assert found is not None
    assert found.scale.scale == pytest.approx(true_scale, rel=5e-3)
    np.testing.assert_allclose(found.gravity_world, R_model_world @ GRAVITY, atol=0.02)
    np.testing.assert_allclose(found.accel_bias, accel_bias, atol=0.02)


def test_increments_reproduce_the_motion() -> None:
    t, poses, v, imu = lively_motion(5.0)
    step = InertialTrack(imu, np.zeros(3)).increments(t[[100, 400]])
    dt, R = 1.5, poses[100, :3, :3]
    np.testing.assert_allclose(R @ step.R[0], poses[400, :3, :3], atol=1e-6)
    np.testing.assert_allclose(v[100] + GRAVITY * dt + R @ step.velocity[0], v[400], atol=1e-3)
    p = poses[100, :3, 3] + v[100] * dt + 0.5 * GRAVITY * dt**2 + R @ step.position[0]
    np.testing.assert_allclose(p, poses[400, :3, 3], atol=1e-3)


def test_both_ways_of_integrating_tell_the_same_motion_and_how_it_depends_on_the_bias() -> None:
    t, _, _, imu = lively_motion(5.0)
    buffer = ImuBuffer(REFERENCE_IMU, keep_s=10.0)
    buffer.add(imu)
    begin, end, bias = int(t[100]), int(t[400]), np.array([0.01, -0.02, 0.015])
    step = InertialTrack(imu, bias).increments(np.array([begin, end]))
    link = preintegrate(buffer.segment(begin, end), np.concatenate([bias, np.zeros(3)]), REFERENCE_IMU)
    np.testing.assert_allclose(link.dR, step.R[0], atol=1e-12)
    np.testing.assert_allclose(link.dv, step.velocity[0], atol=2e-5)
    np.testing.assert_allclose(link.dp, step.position[0], atol=2e-5)
    np.testing.assert_allclose(link.dR_by_bias, -step.R[0].T @ step.R_sum[0], atol=1e-5)
    np.testing.assert_allclose(link.dv_by_bias[:, 3:], -step.R_sum[0], atol=1e-5)
    np.testing.assert_allclose(link.dp_by_bias[:, 3:], -step.R_sum_sum[0], atol=1e-5)


def test_contradicting_scales_are_less_certain() -> None:
    agree = fuse_scales([ScaleEstimate(1.0, 0.05, "imu"), ScaleEstimate(1.02, 0.05, "drive")])
    differ = fuse_scales([ScaleEstimate(1.0, 0.05, "imu"), ScaleEstimate(1.5, 0.05, "drive")])
    assert agree is not None and differ is not None
    assert agree.sigma_relative < 0.05 < differ.sigma_relative
    assert fuse_scales([]) is None


def flat_drive() -> tuple[list[DriveSample], ImuBatch]:
    """2 s at rest, 4 s straight at 0.3 m/s, 4 s of turning at 0.5 rad/s; gyroscope bias 0.02 rad/s about z."""
    drive = [DriveSample(0, 0.0, 0.0), DriveSample(2 * 10**9, 0.3, 0.0), DriveSample(6 * 10**9, 0.3, 0.5)]
    t = np.arange(0, 10 * RATE_HZ) * (10**9 // RATE_HZ)
    gyro = np.zeros((len(t), 3))
    gyro[t >= 6 * 10**9, 2] = 0.5
    gyro[:, 2] += 0.02
    return drive, ImuBatch(t, gyro, np.tile([0.0, 0.0, 9.81], (len(t), 1)))


def test_dead_reckoning_follows_the_commands() -> None:
    drive, imu = flat_drive()
    bias = bias_at_rest(imu, drive)
    assert bias is not None
    np.testing.assert_allclose(bias, [0, 0, 0.02])
    odometry = dead_reckon(imu, drive, np.array([0, 6 * 10**9, 9 * 10**9]), REFERENCE_IMU)
    assert odometry.T_world_body[1, 0, 3] == pytest.approx(0.3 * (4.0 - MOTOR_LAG_S), abs=1e-3)
    turned = odometry.T_world_body[2, :3, :3]
    np.testing.assert_allclose(turned, yaw_rotation(1.5), atol=5e-3)


def test_scale_from_straight_pieces_of_the_drive() -> None:
    drive = [DriveSample(0, 0.3, 0.0)]
    t = np.arange(10) * 10**9
    p = np.column_stack([0.3 * t * 1e-9 / 4.0, np.zeros(10), np.zeros(10)])
    found = scale_from_drive(drive, t, np.broadcast_to(np.eye(3), (10, 3, 3)), p)
    assert found is not None and found.scale == pytest.approx(4.0, rel=0.01)
    assert scale_from_drive([], t, np.broadcast_to(np.eye(3), (10, 3, 3)), p) is None


def test_tracks_join_matches_and_refuse_contradictions() -> None:
    chain = [(0, 1, np.array([[0, 1], [2, 3]])), (1, 2, np.array([[1, 0]]))]
    tracks = build_tracks([5, 5, 5], chain)
    assert tracks.num_points == 2
    assert sorted(np.bincount(tracks.point).tolist()) == [2, 3]
    # Feature 0 of keyframe 0 meets features 1 and 4 of keyframe 1: both observations there go.
    twice = build_tracks([5, 5, 5], [*chain, (1, 2, np.array([[4, 0]]))])
    seen = set(zip(twice.keyframe.tolist(), twice.feature.tolist(), strict=True))
    assert (1, 1) not in seen and (1, 4) not in seen and (0, 0) in seen and (2, 0) in seen
    assert longest(tracks, 1).any()
    assert build_tracks([3, 3], []).num_points == 0


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000))
def test_points_are_found_where_rays_meet(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-1, -1, 3], [1, 1, 5], (5, 3))
    centres = rng.uniform(-0.5, 0.5, (3, 3))
    owner = np.repeat(np.arange(5), 3)
    start = np.tile(centres, (5, 1))
    rays = points[owner] - start
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    found, good = intersect_rays(owner, 5, start, rays)
    np.testing.assert_allclose(found[good], points[good], atol=1e-6)
    behind, good_behind = intersect_rays(owner, 5, start, -rays)
    assert not good_behind.any() and behind.shape == (5, 3)


@pytest.mark.parametrize("max_dense", [4200, 0])  # 0: the sparse solver of drives through rooms
def test_bundle_adjustment_corrects_poses_and_survives_outliers(
    max_dense: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(odometry_bundle, "MAX_DENSE", max_dense)
    rng = np.random.default_rng(5)
    T_body_cam = se3(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.1, 0.0, 0.0]))
    n, m = 12, 150
    truth = np.stack(
        [se3(yaw_rotation(0.03 * k), np.array([0.15 * k, 0.02 * k * k, 0.01 * (k % 3)])) for k in range(n)]
    )
    points = rng.uniform([3, -2, -1], [7, 2, 1], (m, 3))
    keyframe, point = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
    p_cam = np.vstack([transform(inverse(T @ T_body_cam), points) for T in truth])
    xy = p_cam[:, :2] / p_cam[:, 2:]
    xy += rng.normal(scale=0.3 / 500, size=xy.shape)
    wrong = rng.random(len(xy)) < 0.05
    xy[wrong] += rng.normal(scale=0.2, size=(int(wrong.sum()), 2))
    seen = Observations(keyframe, point, xy, inverse(T_body_cam), 500.0)
    relative = inverse(truth[:-1]) @ truth[1:]
    drift = np.stack(
        [T @ se3(so3_exp(rng.normal(scale=0.002, size=3)), rng.normal(scale=0.01, size=3)) for T in relative]
    )
    guess = [truth[0]]
    for step in drift:
        guess.append(guess[-1] @ step)
    start = np.stack(guess)
    odometry = Odometry(
        T_world_body=start,
        R=drift[:, :3, :3],
        R_sum=np.zeros((n - 1, 3, 3)),
        p=drift[:, :3, 3],
        sigma_rotation=np.full(n - 1, 0.002),
        sigma_position=np.full((n - 1, 3), 0.01),
        drift=DEAD_RECKONED,
        slips=np.ones(n - 1, dtype=bool),
        track=InertialTrack(flat_drive()[1], np.zeros(3)),
    )
    state = BundleState(start[:, :3, :3], start[:, :3, 3], points + rng.normal(scale=0.1, size=(m, 3)), MOTION_START)
    before = align_points(truth[:, :3, 3], start[:, :3, 3], "sim3").rms
    for scale in (10.0, 2.0):
        state = adjust(state, seen, odometry, scale, max_iterations=20)
    # The scale stays the odometry's: pictures have none.
    after = align_points(truth[:, :3, 3], state.p_world_body, "sim3").rms
    assert after < 0.3 * before and after < 0.005
    assert np.median(reprojection_errors(state, seen)[~wrong]) < 0.5
    assert np.linalg.norm(so3_log(np.swapaxes(truth[:, :3, :3], 1, 2) @ state.R_world_body), axis=1).max() < 0.004


def test_every_frame_between_keyframes_gets_a_pose() -> None:
    t, poses, _, imu = lively_motion(6.0)
    track = InertialTrack(imu, np.array([0.0, 0.0, 0.01]))  # a wrong bias: its effect is spread over each interval
    keys, frames = t[::100], t[5:-150:10]
    trajectory = all_frames(keys, poses[::100], frames, track)
    at = np.searchsorted(t, trajectory.t_robot_ns)
    assert set(frames[frames <= keys[-1]].tolist()) <= set(trajectory.t_robot_ns.tolist())
    assert np.abs(trajectory.T_world_body[:, :3, :3] - poses[at, :3, :3]).max() < 0.01
    assert np.abs(trajectory.T_world_body[:, :3, 3] - poses[at, :3, 3]).max() < 0.05
    gap = all_frames(np.array([0, 10 * 10**9]), poses[:2], np.array([5 * 10**9]), None)
    assert gap.t_robot_ns.tolist() == [0, 10 * 10**9]


def test_camera_calibration_is_needed() -> None:
    from shared.calibration import Calibration
    from shared.errors import ConfigError
    from station.slam.backends import make_backend

    with pytest.raises(ConfigError, match="needs a camera"):
        make_backend("sfm", Calibration(camera=None, imu=None))
    with pytest.raises(ConfigError, match="unknown"):
        make_backend("orb", Calibration(camera=CameraCalibration(width=9, height=9, fx=1, fy=1, cx=1, cy=1), imu=None))
