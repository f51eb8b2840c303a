"""Landmarks that arrive while the robot drives."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.model.slam_update import SlamUpdate
from station.robots.live_slam import MAX_LIVE_POSES, LivePath, LivePose, LiveSlam, PointBuffer
from tests.support.memory import grown_bytes


@given(counts=st.lists(st.integers(0, 3000), max_size=6))
def test_point_buffer_keeps_all_points_in_order(counts: list[int]) -> None:
    buffer, total = PointBuffer(), 0
    for count in counts:
        p = np.arange(total, total + count, dtype=np.float32)[:, None].repeat(3, axis=1)
        buffer.add(p, np.full((count, 3), 7, np.uint8))
        total += count
    p, rgb = buffer.since(0)
    assert len(buffer) == total == len(p) and (p[:, 0] == np.arange(total)).all() and (rgb == 7).all()
    assert len(buffer.since(total)[0]) == 0


def pose(number: int) -> LivePose:
    T = np.eye(4)
    T[0, 3] = number
    return LivePose(number, T, 0)


@given(num_poses=st.integers(0, 400), max_poses=st.integers(1, 20).map(lambda half: 2 * half))
def test_a_long_way_is_thinned_out_evenly_and_ends_at_the_newest_pose(num_poses: int, max_poses: int) -> None:
    path = LivePath(max_poses)
    for number in range(num_poses):
        path.add(pose(number))
    way = path.trajectory()
    times = way.t_robot_ns.tolist()
    assert way.T_world_body[:, 0, 3].tolist() == times and path.num_seen == num_poses
    if num_poses <= max_poses:
        assert times == list(range(num_poses))
    else:
        steps = np.diff(times)
        assert max_poses // 2 <= len(times) <= max_poses + 1 and times[0] == 0 and times[-1] == num_poses - 1
        assert len(set(steps[:-1].tolist())) <= 1 and 0 < steps[-1] <= steps[0]


def test_where_the_robot_is_and_new_points_are_shown_in_the_map_of_what_was_seen_again() -> None:
    live = LiveSlam("nav-1")
    T_map_world = np.eye(4)
    T_map_world[:2, 3] = 0.5, -0.25
    points = np.array([[1.0, 2.0, 3.0]])
    live.update(SlamUpdate(1, "tracking", "", pose(4).T_world_body, 0, False, points, T_map_world=T_map_world))
    assert live.pose is not None
    assert live.pose.T_world_body[:3, 3].tolist() == [4.5, -0.25, 0.0]
    assert live.points.since(0)[0].tolist() == [[1.5, 1.75, 3.0]]


def test_a_navigation_of_hours_takes_the_memory_of_its_first_minutes() -> None:
    live = LiveSlam("nav-1")

    def drive(first: int) -> None:
        for number in range(first, first + MAX_LIVE_POSES):
            live.update(SlamUpdate(number, "tracking", "", pose(number).T_world_body, 0, False))

    assert grown_bytes(lambda: drive(0), lambda: drive(MAX_LIVE_POSES)) < 10_000
    assert live.frames == 2 * MAX_LIVE_POSES
