"""Landmarks and depth are seen alike: where they are, and from where."""

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import yaw_rotation
from station.model.navigation import Navigation
from station.places.rooms.plan import plan_along
from station.places.rooms.wall_model import wall_model
from station.places.space.observed import CUBE_M, Observed
from station.places.space.space import Space
from tests.support.depth import HIGH, LOW, depth_camera, map_of, scanned, way


def few_landmarks(navigation: Navigation) -> Navigation:
    """As a plain home's map: one observation in a hundred."""
    landmarks = navigation.landmarks
    kept = np.arange(len(landmarks.observed_landmark)) % 100 == 0
    return replace(
        navigation,
        landmarks=replace(
            landmarks,
            observed_landmark=landmarks.observed_landmark[kept],
            observed_keyframe=landmarks.observed_keyframe[kept],
            observed_uv_px=landmarks.observed_uv_px[kept],
        ),
    )


def test_without_depth_it_is_landmarks_and_keyframes_to_the_last_bit() -> None:
    navigation = map_of(way())
    seen, landmarks = Observed.of(navigation), navigation.landmarks
    assert seen.p_map is landmarks.p_world
    assert seen.point is landmarks.observed_landmark and seen.eye is landmarks.observed_keyframe
    np.testing.assert_array_equal(seen.eye_map, navigation.keyframes.T_world_cam[:, :3, 3])
    for ours, theirs in zip(seen.by_eye(), landmarks.observations_by_keyframe(len(seen.eye_map)), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(seen.num_observations, landmarks.num_observations)


def test_without_metres_depth_says_nothing() -> None:
    T, sensor = way(), depth_camera()
    metric = scanned(map_of(T), sensor, T)
    arbitrary = replace(metric, report=replace(metric.report, scale="arbitrary"))
    assert len(Observed.of(arbitrary).p_map) == len(metric.landmarks)


def test_depth_lies_on_the_rooms_surface_and_counts_once_for_each_scan() -> None:
    T, sensor = way(), depth_camera()
    navigation = scanned(map_of(T), sensor, T)
    seen, count = Observed.of(navigation), len(navigation.landmarks)
    p = seen.p_map[count:]
    assert len(p) > 3000
    off = np.abs(np.stack([p - LOW, HIGH - p])).min(axis=(0, 2))
    assert np.percentile(off, 99) < 0.5 * CUBE_M and off.max() < CUBE_M
    assert len(np.unique(np.stack([seen.point, seen.eye]), axis=1).T) == len(seen.point)
    assert seen.num_observations[count:].min() >= 1
    rows = seen.by_eye()[len(navigation.keyframes)]
    eye = seen.eye_map[len(navigation.keyframes)]
    np.testing.assert_allclose(eye, (T[0] @ sensor.T_body_depth_matrix)[:3, 3], atol=1e-9)
    ahead = (seen.p_map[seen.point[rows]] - eye) @ T[0][:3, 0]
    assert (ahead > 0).all()


def test_a_robot_that_stands_still_is_not_heard_a_thousand_times() -> None:
    T, sensor = np.repeat(way(1), 40, axis=0), depth_camera()
    navigation = scanned(map_of(T), sensor, T)
    assert navigation.depth is not None and len(navigation.depth) == 20
    assert len(Observed.of(navigation).eye_map) == len(navigation.keyframes) + 1


def test_scans_whose_pose_nobody_knows_are_left_out() -> None:
    T, sensor = way(), depth_camera()
    navigation = scanned(map_of(T), sensor, T)
    assert navigation.depth is not None
    later = replace(navigation, depth=replace(navigation.depth, t_robot_ns=navigation.depth.t_robot_ns + 10**10))
    assert len(Observed.of(later).p_map) == len(navigation.landmarks)
    assert Space.of(later).free.shape == Space.of(replace(navigation, depth=None)).free.shape


def test_depth_shows_free_space_where_landmarks_are_few() -> None:
    T = way()
    plain = few_landmarks(map_of(T))
    seen = scanned(plain, depth_camera(), T)
    area = [float(space.free.sum()) * space.cell**2 for space in (Space.of(plain), Space.of(seen))]
    assert area[1] > 1.5 * area[0]
    space = Space.of(seen)
    corners = np.argwhere(space.free) * space.cell + space.low
    assert (corners > LOW[:2] - space.cell).all() and (corners < HIGH[:2]).all()


@pytest.mark.parametrize("turned", [0.0, 0.4])
def test_walls_of_a_plan_by_depth_are_the_rooms(turned: float) -> None:
    T = way(80)
    T[:, :3, :3] = [yaw_rotation(yaw) for yaw in np.linspace(turned, turned + 2 * np.pi, len(T))]
    navigation = scanned(few_landmarks(map_of(T)), depth_camera(), T)
    plan = plan_along(np.eye(3), navigation, (), wall_model())
    assert len(plan.rooms) == 1
    low, high = plan.walls.reshape(-1, 2).min(axis=0), plan.walls.reshape(-1, 2).max(axis=0)
    np.testing.assert_allclose(low, LOW[:2], atol=0.11)
    np.testing.assert_allclose(high, HIGH[:2], atol=0.11)
    across = [axis for wall in plan.walls for axis in (0, 1) if wall[0, axis] == wall[1, axis]]
    at = [wall[0, axis] for wall, axis in zip(plan.walls, across, strict=True)]
    for axis, where in zip(across, at, strict=True):
        assert min(abs(where - LOW[axis]), abs(where - HIGH[axis])) < 0.03
