"""ATE and RPE agree with evo."""

import numpy as np
import pytest

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, quat_from_rotation, se3, so3_exp, transform, yaw_rotation
from station.experiments.trajectory_error import (
    absolute_trajectory_error,
    path_length,
    relative_pose_error,
)
from station.model.navigation import Trajectory
from station.motion.interpolation import interpolate_poses


def wander(seed: int, count: int = 60) -> FloatArray:
    """A smooth path with turning, (count, 4, 4)."""
    rng = np.random.default_rng(seed)
    T, poses = np.eye(4), []
    turn = rng.normal(scale=0.05, size=3)
    for _ in range(count):
        poses.append(T)
        turn = turn + rng.normal(scale=0.02, size=3)
        T = T @ se3(so3_exp(turn), np.array([0.1, 0.0, 0.0]) + rng.normal(scale=0.02, size=3))
    return np.array(poses)


def noisy_pair(seed: int) -> tuple[Trajectory, Trajectory]:
    rng = np.random.default_rng(seed + 100)
    t = np.arange(60) * 100_000_000 + 1403715273262142976
    truth = wander(seed)
    noise = np.array([se3(so3_exp(rng.normal(scale=0.01, size=3)), rng.normal(scale=0.03, size=3)) for _ in truth])
    moved = se3(so3_exp(rng.normal(size=3)), rng.normal(size=3)) @ truth @ noise
    moved[:, :3, 3] *= 1.7
    return Trajectory(t, moved), Trajectory(t, truth)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["se3", "sim3"])
def test_absolute_and_relative_errors_agree_with_evo(kind: str) -> None:
    evo_metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PoseTrajectory3D

    estimate, truth = noisy_pair(3)

    def as_evo(poses: Trajectory) -> object:
        q = np.array([quat_from_rotation(T[:3, :3]) for T in poses.T_world_body])
        return PoseTrajectory3D(poses.T_world_body[:, :3, 3].copy(), q, (poses.t_robot_ns - poses.t_robot_ns[0]) * 1e-9)

    theirs_est, theirs_truth = as_evo(estimate), as_evo(truth)
    theirs_est.align(theirs_truth, correct_scale=kind == "sim3")  # type: ignore[attr-defined]
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((theirs_truth, theirs_est))
    ours = absolute_trajectory_error(estimate, truth, "sim3" if kind == "sim3" else "se3")
    assert ours.rmse_m == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-9)
    angle = evo_metrics.APE(evo_metrics.PoseRelation.rotation_angle_rad)
    angle.process_data((theirs_truth, theirs_est))
    assert ours.rotation_rmse_rad == pytest.approx(angle.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-6)

    rpe = evo_metrics.RPE(evo_metrics.PoseRelation.translation_part, 10, evo_metrics.Unit.frames, all_pairs=True)
    rpe.process_data((theirs_truth, theirs_est))
    relative = relative_pose_error(estimate, truth, 1.0, scale=ours.alignment.scale)
    assert relative.num_pairs == 50
    assert relative.translation_rmse_m == pytest.approx(rpe.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-9)


def test_errors_are_given_along_the_axes_of_the_truth() -> None:
    truth = Trajectory(np.arange(60) * 10**8, wander(2))
    tilted = truth.T_world_body.copy()
    tilted[:, :3, :3] = so3_exp(np.array([0.02, 0.0, 0.0])) @ tilted[:, :3, :3]
    tilted[::2, 2, 3] += 0.01
    tilted[1::2, 2, 3] -= 0.01
    error = absolute_trajectory_error(Trajectory(truth.t_robot_ns, tilted), truth, "yaw")
    np.testing.assert_allclose(error.turns_rad, np.tile([0.02, 0.0, 0.0], (60, 1)), atol=1e-4)
    np.testing.assert_allclose(error.offsets_m[:, 2], np.where(np.arange(60) % 2, -0.01, 0.01), atol=1e-9)
    assert error.rmse_m == pytest.approx(0.01, abs=1e-5) and error.rotation_rmse_rad == pytest.approx(0.02, rel=1e-3)


def test_a_second_is_a_second_though_stamps_are_rounded() -> None:
    t = np.array([round(k * 1e9 / 30) for k in range(60)])
    path = Trajectory(t, wander(4))
    assert relative_pose_error(path, path, 1.0).num_pairs == 30


def test_yaw_alignment_leaves_tilt_in_the_error() -> None:
    truth = Trajectory(np.arange(60) * 10**8, wander(1))
    turned = se3(yaw_rotation(2.0), np.array([1.0, 2, 3])) @ truth.T_world_body
    assert absolute_trajectory_error(Trajectory(truth.t_robot_ns, turned), truth).rmse_m < 1e-9
    tilted = se3(so3_exp(np.array([0.1, 0, 0])), np.zeros(3)) @ truth.T_world_body
    error = absolute_trajectory_error(Trajectory(truth.t_robot_ns, tilted), truth)
    assert error.rotation_rmse_rad > 0.05
    assert absolute_trajectory_error(Trajectory(truth.t_robot_ns, tilted), truth, "se3").rmse_m < 1e-9


def test_truth_is_interpolated_but_not_across_gaps() -> None:
    t = np.array([0, 100, 200, 1000]) * 1_000_000
    poses = np.stack([se3(yaw_rotation(0.1 * i), np.array([float(i), 0, 0])) for i in range(4)])
    T, kept = interpolate_poses(Trajectory(t, poses), np.array([-1, 0, 50, 200, 500, 2000]) * 1_000_000)
    assert kept.tolist() == [1, 2, 3]
    np.testing.assert_allclose(T[1], se3(yaw_rotation(0.05), np.array([0.5, 0, 0])), atol=1e-12)


def test_too_little_in_common_is_refused() -> None:
    a = Trajectory(np.arange(5) * 10**8, wander(1, 5))
    b = Trajectory(np.arange(5) * 10**8 + 10**12, wander(1, 5))
    with pytest.raises(DegenerateGeometry, match="share 0"):
        absolute_trajectory_error(a, b)
    with pytest.raises(DegenerateGeometry, match="apart"):
        relative_pose_error(a, a, 10.0)
    assert path_length(a) > 0.3
    np.testing.assert_allclose(transform(np.eye(4), a.T_world_body[:, :3, 3]), a.T_world_body[:, :3, 3])
