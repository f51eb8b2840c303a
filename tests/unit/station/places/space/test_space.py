"""What a map knows: a room that was driven through, a neighbour seen through its door, whatever its scale and axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray, carry_poses, se3, sim3, so3_exp, transform, yaw_rotation
from station.model.navigation import Navigation, NavigationReport
from station.places.space.space import Space
from tests.support.places import estimator_of, seen
from tests.support.rooms import mapped, room_with_a_door, walls

WITHIN = np.array([[2.5, 2.0, 0.0], [1.3, 2.0, 0.0], [2.0, 3.3, 0.0], [3.3, 3.0, 0.0]])
BEYOND = np.array([[4.8, 2.1, 0.0], [4.9, 1.5, 0.0], [4.8, 2.6, 0.0]])


def test_off_the_path_but_in_the_room_it_is_known() -> None:
    space = Space.of(room_with_a_door().navigation)
    assert space.knows(WITHIN).all()
    assert not space.knows(np.array([[2.0, 11.0, 0.0], [-40.0, 0.0, 0.0]])).any()


def test_beyond_a_door_that_was_only_looked_through_the_map_ends() -> None:
    space = Space.of(room_with_a_door().navigation)
    assert not space.knows(BEYOND).any()
    assert space.free[tuple(np.floor((BEYOND[0, :2] - space.low) / space.cell).astype(int))], "it was seen to be free"


def test_of_a_corridor_driven_one_way_is_known_what_was_seen_or_is_at_hand() -> None:
    x = np.linspace(0.5, 3.5, 20)
    corridor = mapped(np.column_stack([x, np.full(20, 2.0)]), np.zeros(20), walls())
    space = Space.of(corridor.navigation)
    assert space.knows(np.array([[1.0, 2.3, 0.0], [3.5, 2.6, 0.0], [3.6, 1.4, 0.0]])).all()
    assert not space.knows(np.array([[1.0, 2.8, 0.0], [0.5, 1.0, 0.0]])).any()  # beside the camera all the time


def two_ways(apart_m: float) -> Space:
    """Of a hall driven through to and fro along two ways this far from each other, by a camera that sees 5 degrees."""
    x = np.linspace(0.5, 3.5, 40)
    y = np.concatenate([np.full(40, 2.0), np.full(40, 2.0 + apart_m)])
    hall = mapped(np.column_stack([np.tile(x, 2), y]), np.zeros(80), walls())
    return Space.of(hall.navigation)


def test_a_gap_that_is_narrower_than_a_passage_hides_no_room() -> None:
    def between(apart_m: float) -> FloatArray:
        return np.array([[0.6, 2.0 + 0.5 * apart_m, 0.0]])  # beside the camera on both ways

    assert two_ways(1.2).knows(between(1.2)).all()
    assert not two_ways(2.6).knows(between(2.6)).any()


def moved(navigation: Navigation, T: FloatArray, report: NavigationReport) -> Navigation:
    """The same in another frame and scale: a similarity T (4, 4)."""
    keyframes, trajectory = navigation.keyframes, navigation.trajectory
    return replace(
        navigation,
        keyframes=replace(keyframes, T_world_cam=carry_poses(T, keyframes.T_world_cam)),
        trajectory=replace(trajectory, T_world_body=carry_poses(T, trajectory.T_world_body)),
        landmarks=navigation.landmarks.moved(T),
        report=report,
    )


@pytest.mark.parametrize("scale", [0.1, 7.0])
def test_a_map_of_any_scale_and_tilt_knows_the_same_space(scale: float) -> None:
    navigation = room_with_a_door().navigation
    T = sim3(scale, so3_exp(np.array([0.9, -0.4, 1.1])), np.array([3.0, -20.0, 5.0]))
    unknown = replace(navigation.report, scale="arbitrary", gravity_aligned=False)
    here = Space.of(replace(navigation, report=unknown))
    there = Space.of(moved(navigation, T, unknown))
    outside = np.array([[4.8, 3.5, 0.0], [4.8, 0.5, 0.0], [2.0, 11.0, 0.0]])
    for p in (WITHIN, BEYOND, outside):
        assert here.knows(p).tolist() == there.knows(transform(T, p)).tolist()
    assert here.knows(WITHIN).all() and not here.knows(BEYOND).any() and not here.knows(outside).any()


@given(st.floats(-np.pi, np.pi), st.floats(-5, 5))
def test_the_path_itself_is_known_however_the_map_lies(yaw: float, shift: float) -> None:
    navigation = room_with_a_door().navigation
    T = se3(yaw_rotation(yaw), np.array([shift, -shift, 0.0]))
    space = Space.of(moved(navigation, T, navigation.report))
    assert space.knows(transform(T, navigation.keyframes.T_world_cam[:, :3, 3])).all()


def test_a_navigation_that_saw_nothing_knows_nothing() -> None:
    navigation = room_with_a_door().navigation
    keyframes = replace(
        navigation.keyframes,
        frame_index=np.zeros(0, np.int64),
        t_robot_ns=np.zeros(0, np.int64),
        T_world_cam=np.zeros((0, 4, 4)),
        encoded=(),
        segment=np.zeros(0, np.int64),
    )
    nowhere = replace(navigation.trajectory, t_robot_ns=np.zeros(0, np.int64), T_world_body=np.zeros((0, 4, 4)))
    empty = replace(
        navigation.landmarks,
        observed_landmark=np.zeros(0, np.int64),
        observed_keyframe=np.zeros(0, np.int64),
        observed_uv_px=np.zeros((0, 2)),
    )
    blind = replace(navigation, keyframes=keyframes, landmarks=empty, trajectory=nowhere)
    assert not Space.of(blind).knows(WITHIN).any()


def test_a_robot_behind_the_door_is_told_that_it_is_not_in_the_map() -> None:
    estimator = estimator_of(room_with_a_door())
    many = tuple(range(400))
    for k in range(6):  # looks back through the door and knows exactly where it is
        estimator.on_candidates([seen(k, se3(yaw_rotation(np.pi), np.array([4.9, 2.0, 0.0])), landmarks=many)])
    answer = estimator.answer(6 * 10**9)
    assert answer.state == "unknown" and answer.position_map is not None
    assert "door" in answer.reason
    for k in range(6, 14):  # drives back in
        estimator.on_candidates([seen(k, se3(yaw_rotation(np.pi), np.array([3.0, 2.0, 0.0])), landmarks=many)])
    assert estimator.answer(13 * 10**9).state == "known"
