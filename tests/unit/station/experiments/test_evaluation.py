"""What `station evaluate` says of a navigation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from shared.calibration import REFERENCE_ROBOT, Calibration
from shared.errors import DataError
from shared.geometry import FloatArray, carry_poses, inverse, se3, sim3, so3_exp, yaw_rotation
from station.datasets import Dataset, Truth
from station.experiments.evaluation import evaluate, has_pose, usual_alignment
from station.model.navigation import Navigation, Trajectory
from tests.support.synthetic_home import CAMERA, drive, furnished_room, navigate

SECOND = 1_000_000_000
CAMERA_ONLY = Calibration(camera=CAMERA, imu=None)


def drive_with_truth(T_nav_world: FloatArray, *, metric: bool = True, gravity: bool = True) -> tuple[Navigation, Truth]:
    """A navigation without error in a frame of its own, ten poses a second, and the truth."""
    home = furnished_room(3)
    poses = drive(home, 5, frames=40)
    made = navigate(home, poses, 5, T_nav_world=T_nav_world, metric=metric, gravity=gravity, images=False)
    return made, Truth(made.trajectory.t_robot_ns, poses)


def dataset(truth: Truth | None, frames: int = 40, calibration: Calibration = CAMERA_ONLY) -> Dataset:
    times = np.arange(frames, dtype=np.int64) * SECOND // 10
    return Dataset(Path("drive"), "images", calibration, True, times, None, truth=truth)


@pytest.mark.parametrize(
    ("metric", "gravity", "kind"),
    [(True, True, "yaw"), (True, False, "se3"), (False, True, "sim3"), (False, False, "sim3")],
)
def test_what_a_navigation_leaves_open_is_fitted(metric: bool, gravity: bool, kind: str) -> None:
    navigation, truth = drive_with_truth(np.eye(4), metric=metric, gravity=gravity)
    assert usual_alignment(navigation) == kind
    assert evaluate(navigation, dataset(truth)).results()["align"] == kind


def test_a_navigation_without_error_is_free_of_error_and_its_scale_is_found() -> None:
    T = sim3(2.5, so3_exp(np.array([0.3, -1.0, 2.0])), np.array([4.0, 5.0, 6.0]))
    navigation, truth = drive_with_truth(T, metric=False)
    found = evaluate(navigation, dataset(truth))
    assert found.results() == {
        "ate_rmse": pytest.approx(0, abs=1e-9),
        "rpe_1s_rmse": pytest.approx(0, abs=1e-9),
        "rot_rmse_deg": pytest.approx(0, abs=1e-5),
        "scale": pytest.approx(0.4),
        "coverage": 1.0,
        "align": "sim3",
        "poses": 40,
    }
    np.testing.assert_allclose(found.aligned.T_world_body, truth.T_world_body, atol=1e-9)


def test_wrong_metres_are_an_error_unless_scale_may_be_fitted() -> None:
    navigation, truth = drive_with_truth(sim3(1.1, np.eye(3), np.zeros(3)))
    level, free = evaluate(navigation, dataset(truth)), evaluate(navigation, dataset(truth), "sim3")
    assert level.absolute.rmse_m > 0.05 > free.absolute.rmse_m
    assert level.scale == free.scale == pytest.approx(1 / 1.1)


def test_coverage_counts_frames_with_truth_that_have_a_pose() -> None:
    navigation, truth = drive_with_truth(np.eye(4))
    assert evaluate(navigation, dataset(truth, frames=80)).coverage == 1.0  # beyond the truth nothing is asked
    path = navigation.trajectory
    half = replace(navigation, trajectory=Trajectory(path.t_robot_ns[:20], path.T_world_body[:20]))
    assert evaluate(half, dataset(truth)).coverage == 0.5
    lost = np.r_[0:5, 20:40]  # 1.6 s without a pose
    gap = replace(navigation, trajectory=Trajectory(path.t_robot_ns[lost], path.T_world_body[lost]))
    assert evaluate(gap, dataset(truth)).coverage == 25 / 40
    sparse = replace(navigation, trajectory=Trajectory(path.t_robot_ns[::5], path.T_world_body[::5]))
    assert evaluate(sparse, dataset(truth)).coverage == 36 / 40  # the last frames come after its last pose


def test_no_time_has_a_pose_where_there_are_none() -> None:
    assert not has_pose(np.zeros(0, np.int64), np.arange(3), SECOND).any()
    assert has_pose(np.array([0, SECOND]), np.array([-SECOND, SECOND // 2, 2 * SECOND]), SECOND).tolist() == [
        False,
        True,
        False,
    ]


def test_too_short_a_navigation_has_no_drift_over_a_second() -> None:
    navigation, truth = drive_with_truth(np.eye(4))
    path = navigation.trajectory
    short = replace(navigation, trajectory=Trajectory(path.t_robot_ns[:8], path.T_world_body[:8]))
    assert evaluate(short, dataset(truth)).results()["rpe_1s_rmse"] is None


def test_images_of_a_rig_with_imu_are_judged_by_the_camera() -> None:
    """Truth is of the IMU by its clock; a navigation from the images alone has the camera's poses at its times."""
    navigation, cameras = drive_with_truth(se3(yaw_rotation(1.0), np.ones(3)))
    camera = REFERENCE_ROBOT.camera
    assert camera is not None and REFERENCE_ROBOT.imu is not None
    camera = msgspec.structs.replace(camera, time_shift_s=0.02)
    with_imu = Calibration(camera=camera, imu=REFERENCE_ROBOT.imu)
    imu = Truth(cameras.t_robot_ns + 20_000_000, cameras.T_world_body @ inverse(camera.T_body_cam_matrix))
    assert evaluate(navigation, dataset(imu, calibration=with_imu)).absolute.rmse_m < 1e-9
    assert np.abs(camera.T_body_cam_matrix[:3, 3]).max() > 0.01  # else nothing was shown


def test_a_dataset_without_truth_is_named() -> None:
    navigation, _ = drive_with_truth(np.eye(4))
    with pytest.raises(DataError, match="drive holds no true poses"):
        evaluate(navigation, dataset(None))


def test_the_frame_of_a_navigation_is_carried_into_the_truths() -> None:
    T = se3(yaw_rotation(2.0), np.array([1.0, 2.0, 3.0]))
    navigation, truth = drive_with_truth(T)
    np.testing.assert_allclose(
        evaluate(navigation, dataset(truth)).aligned.T_world_body,
        carry_poses(inverse(T), navigation.trajectory.T_world_body),
        atol=1e-9,
    )
