"""Two drives become one navigation in the first one's frame."""

import numpy as np
import pytest

from shared.errors import EstimationError
from shared.geometry import inverse, se3, transform, yaw_rotation
from station.places.joining.merge import append_navigation, merge_navigations
from station.places.making.build import build_map
from tests.support.depth import depth_camera, map_of, scanned, way
from tests.support.synthetic_home import drive, furnished_room, navigate


def test_a_second_drive_is_appended_where_it_belongs() -> None:
    home = furnished_room(3, density=100)
    T_second_first = se3(yaw_rotation(1.0), np.array([2.0, 0.0, 0.0]))
    T_second_first[:3, :3] *= 3.0
    first = navigate(home, drive(home, 1, frames=30), seed=1, images=False, noise_m=0.0, outlier_share=0.0)
    poses = drive(home, 2, frames=30)
    second = navigate(
        home, poses, seed=2, images=False, noise_m=0.0, outlier_share=0.0, T_nav_world=T_second_first, metric=False
    )
    both = append_navigation(first, second, np.linalg.inv(T_second_first))
    n = len(first.keyframes)
    np.testing.assert_allclose(both.keyframes.T_world_cam[n:], poses, atol=1e-9)
    assert (np.diff(both.trajectory.t_robot_ns) > 0).all() and (np.diff(both.keyframes.t_robot_ns) > 0).all()
    assert len(np.unique(both.keyframes.frame_index)) == len(both.keyframes)
    # Every observation still points at the landmark it saw: it projects where it was measured.
    landmarks = both.landmarks
    for k in (0, n, len(both.keyframes) - 1):
        seen = landmarks.observed_keyframe == k
        p = transform(inverse(both.keyframes.T_world_cam[k]), landmarks.p_world[landmarks.observed_landmark[seen]])
        np.testing.assert_allclose(p[:, :2] / p[:, 2:] * 120 + [79.5, 59.5], landmarks.observed_uv_px[seen], atol=1e-6)


def test_merged_drives_give_one_map_and_strangers_are_refused() -> None:
    home = furnished_room(3, density=300)
    first = navigate(home, drive(home, 31), seed=31, images=False)
    T = se3(yaw_rotation(2.0), np.array([1.0, 2.0, 0.0]))
    second = navigate(home, drive(home, 32), seed=32, T_nav_world=T, images=False)
    both = merge_navigations([first, second])
    assert len(both.landmarks) == len(first.landmarks) + len(second.landmarks)
    # Twice the landmarks may show finer hills, but not every place twice.
    assert len(build_map(both).places) < 2 * len(build_map(first).places)
    other = furnished_room(77, density=300, size=(3.2, 6.0))
    with pytest.raises(EstimationError, match="could not be placed"):
        merge_navigations([first, navigate(other, drive(other, 5), seed=5, images=False)])


def test_depth_of_both_drives_lies_where_it_was_measured() -> None:
    T, sensor = way(), depth_camera()
    metric = scanned(map_of(T), sensor, T)
    both = append_navigation(metric, metric, np.eye(4))
    assert both.depth is not None and metric.depth is not None
    assert len(both.depth) == 2 * len(metric.depth)
    assert set(both.depth.t_robot_ns.tolist()) <= set(both.trajectory.t_robot_ns.tolist())
    np.testing.assert_array_equal(both.depth.points_body(len(metric.depth)), metric.depth.points_body(0))
    other = scanned(map_of(T), depth_camera(80, 60), T)
    both = append_navigation(metric, other, np.eye(4))
    assert both.depth is not None and both.depth.sensor == metric.depth.sensor
    assert len(both.depth) == len(metric.depth)
    both = append_navigation(map_of(T), other, np.eye(4))
    assert both.depth is not None and other.depth is not None and both.depth.sensor == other.depth.sensor
