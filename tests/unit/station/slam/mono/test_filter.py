from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from shared.geometry import FloatArray, inverse, transform
from station.experiments.trajectory_error import absolute_trajectory_error, path_length
from station.model.navigation import Trajectory
from station.slam.mono.config import MonoConfig
from station.slam.mono.filter import FrameResult, MonoFilter
from station.slam.mono.motion import ATTITUDE, CAMERA
from station.slam.mono.state import Expected, State
from station.vision.lens import BoolArray, Lens
from tests.support.mono import NEES_DEGREES, RATE_HZ, PointFinder, hand_held_camera, hand_held_path, pose_nees
from tests.support.synthetic_run import room_points

SECONDS = 4.0


@cache
def follow(
    seed: int, outliers: float = 0.0, seconds: float = SECONDS
) -> tuple[MonoFilter, Trajectory, Trajectory, list[FrameResult]]:
    """The filter at the end of a sequence of points, the truth, what it found, and what each frame gave."""
    calibration, path = hand_held_camera(), hand_held_path(seed, seconds)
    assert calibration.camera is not None
    lens = Lens(calibration.camera)
    finder = PointFinder(lens, room_points(path.T_world_body[:, :3, 3], seed), 1.0, seed, outliers)
    mono = MonoFilter(lens, MonoConfig())
    poses, results = [], []
    for k, T_world_cam in enumerate(path.T_world_body):
        finder.look_from(T_world_cam)
        results.append(mono.process(1.0 / RATE_HZ if k else 0.0, finder))
        poses.append(mono.state.T_world_cam)
        poses[len(poses) - len(results[-1].again) :] = [state.T_world_cam for state in results[-1].again]
    return mono, path, Trajectory(path.t_robot_ns, np.array(poses)), results


@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_camera_among_points_is_followed_within_two_percent_also_where_some_measurements_are_wrong(
    outliers: float,
) -> None:
    mono, truth, found, results = follow(1, outliers)
    error = absolute_trajectory_error(found, truth, "sim3")
    assert error.rmse_m < 0.02 * path_length(truth)
    last = results[-1]
    assert 0.7 * (1 - outliers) * len(last.expected.rows) <= last.num_found <= len(last.expected.rows)
    assert pose_nees(mono.state, inverse(truth.T_world_body[0]) @ truth.T_world_body[-1]) < chi2.ppf(
        0.999, NEES_DEGREES
    )


def test_start_that_fits_its_mirror_image_better_is_mended_by_the_pictures_that_follow() -> None:
    _, truth, found, _ = follow(106, seconds=10.0)
    error = absolute_trajectory_error(found, truth, "sim3")
    assert np.degrees(error.rotation_rmse_rad) < 5.0 and error.rmse_m < 0.02 * path_length(truth)


def test_features_become_points_where_they_are_known_well_enough() -> None:
    mono, truth, found, _ = follow(1)
    state = mono.state
    assert 0 < state.is_inverse.sum() < len(state.ids)
    assert len(state.x) == CAMERA + 6 * state.is_inverse.sum() + 3 * (~state.is_inverse).sum()
    p = state.points()
    scale = absolute_trajectory_error(found, truth, "sim3").alignment
    p_true = transform(scale.T_target_source, p[~state.is_inverse])
    assert np.isfinite(p_true).all()


def test_covariance_stays_symmetric_and_positive_and_the_attitude_a_rotation() -> None:
    state = follow(1)[0].state
    np.testing.assert_allclose(state.P, state.P.T, atol=1e-12)
    assert np.linalg.eigvalsh(state.P).min() > -1e-9
    np.testing.assert_allclose(state.R @ state.R.T, np.eye(3), atol=1e-12)
    assert not state.x[ATTITUDE].any()


class Blinking(PointFinder):
    """Sees nothing for a moment."""

    is_blind = False

    def find(self, state: State, expected: Expected) -> tuple[FloatArray, BoolArray]:
        uv, found = super().find(state, expected)
        return uv, found & (not self.is_blind)


def test_window_does_not_end_where_nothing_is_seen_since_least_is_known_there() -> None:
    calibration, path = hand_held_camera(), hand_held_path(1, 1.0)
    assert calibration.camera is not None
    lens = Lens(calibration.camera)
    finder = Blinking(lens, room_points(path.T_world_body[:, :3, 3], 1), 1.0, 1)
    mono, results = MonoFilter(lens, MonoConfig()), []
    for k, T_world_cam in enumerate(path.T_world_body[:20]):
        finder.is_blind = k in (12, 13)
        finder.look_from(T_world_cam)
        results.append(mono.process(1.0 / RATE_HZ if k else 0.0, finder))
    assert [len(result.again) for result in results] == [0] * 9 + [10] + [0] * 9 + [20]


def test_map_keeps_its_size() -> None:
    config = MonoConfig()
    mono, _, _, results = follow(1)
    assert len(mono.state.ids) <= config.max_features
    assert all(len(result.expected.rows) <= config.num_measured for result in results)


def test_ellipses_shrink_as_depths_become_known() -> None:
    results = follow(1)[3]
    area = [float(np.median(np.sqrt(np.linalg.det(result.expected.ellipses())))) for result in results[1:]]
    assert np.mean(area[-20:]) < 0.1 * area[0]
