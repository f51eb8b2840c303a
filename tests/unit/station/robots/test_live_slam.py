"""Landmarks that arrive while the robot drives."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import station.robots.live_slam
from shared.geometry import FloatArray
from station.model.slam_update import SlamUpdate
from station.robots.live_slam import (
    LIVE_CELL_M,
    MAX_LIVE_POINTS,
    MAX_LIVE_POSES,
    LivePath,
    LivePose,
    LiveSlam,
    PointBuffer,
)
from tests.support.memory import grown_bytes, peak_bytes


def some_points(number: int, seed: int = 0) -> FloatArray:
    """(n, 3) in a room of 4 m."""
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (number, 3))


def grey(points: npt.NDArray[np.floating]) -> FloatArray:
    return np.full((len(points), 3), 7.0)


@given(counts=st.lists(st.integers(0, 3000), max_size=6))
def test_points_in_cells_of_their_own_are_kept_in_order(counts: list[int]) -> None:
    buffer, total = PointBuffer(20_000), 0
    for count in counts:
        p = np.arange(total, total + count, dtype=np.float32)[:, None].repeat(3, axis=1)
        assert buffer.add(p, grey(p)) == count
        assert (buffer.since(total)[0] == p).all()  # a reader who asks for those since the last total
        total += count
    p, rgb = buffer.since(0)
    assert len(buffer) == total == len(p) and (p[:, 0] == np.arange(total)).all() and (rgb == 7).all()
    assert len(buffer.since(total)[0]) == 0


@given(cuts=st.lists(st.integers(0, 500), max_size=8), seed=st.integers(0, 9))
def test_a_room_that_is_known_adds_no_points(cuts: list[int], seed: int) -> None:
    room = some_points(500, seed)
    buffer = PointBuffer()
    for part in np.split(room, sorted(cuts)):
        buffer.add(part, grey(part))
    known, _ = buffer.since(0)
    apart = np.linalg.norm(known[:, None] - room, axis=2).min(axis=0)
    assert (apart <= LIVE_CELL_M * 3**0.5 + 1e-6).all()  # of each there is one in its cell
    cells = np.rint(known.astype(float) / LIVE_CELL_M)
    assert len(np.unique(cells, axis=0)) == len(known)
    assert buffer.add(room[::-1], grey(room)) == 0 and (buffer.since(0)[0] == known).all()


@given(counts=st.lists(st.integers(1, 200), min_size=1, max_size=20), max_points=st.integers(1, 100))
def test_a_full_buffer_leaves_points_out_evenly_and_is_never_fuller(counts: list[int], max_points: int) -> None:
    buffer = PointBuffer(max_points)
    every = some_points(sum(counts))
    for part in np.split(every, np.cumsum(counts)[:-1]):
        before, renumbered = buffer.since(0)[0], buffer.renumbered
        num_new = buffer.add(part, grey(part))
        after = buffer.since(0)[0]
        assert 1 <= len(after) <= max_points
        if buffer.renumbered == renumbered:  # no reader notices that others were left out
            assert (after[: len(before)] == before).all() and len(after) == len(before) + num_new
    place = {tuple(p): number for number, p in enumerate(every.astype(np.float32).tolist())}
    order = [place[tuple(p)] for p in after.tolist()]
    assert order == sorted(order)
    if len(every) > 8 * max_points:
        assert buffer.renumbered


def test_points_and_poses_are_left_out_alike_however_many_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    left = []
    for at_a_time in (4, 10, 10_000):
        monkeypatch.setattr(station.robots.live_slam, "AT_A_TIME", at_a_time)
        buffer, path = PointBuffer(100), LivePath(100)
        buffer.add(some_points(90), grey(some_points(90)))
        buffer.add(some_points(50, 1), grey(some_points(50, 1)))
        for number in range(150):
            path.add(pose(number))
        assert buffer.renumbered == 1
        way = path.trajectory()
        left.append((buffer.since(0)[0].tolist(), way.t_robot_ns.tolist(), way.T_world_body.tolist()))
    assert left[0] == left[1] == left[2]


def test_leaving_points_and_poses_out_takes_little_memory_meanwhile() -> None:
    buffer, path = PointBuffer(), LivePath()
    apart = np.arange(MAX_LIVE_POINTS + 1)[:, None] * [0.1, 0.0, 0.0]
    buffer.add(apart[:-1], grey(apart[:-1]))
    last, colour = apart[-1:], grey(apart[-1:])
    for number in range(MAX_LIVE_POSES):
        path.add(pose(number))
    assert peak_bytes(lambda: buffer.add(last, colour)) < 500_000 and buffer.renumbered
    assert peak_bytes(lambda: path.add(pose(MAX_LIVE_POSES))) < 500_000 and len(path.trajectory()) < MAX_LIVE_POSES


def test_where_nothing_is_known_is_not_a_point_and_far_away_is() -> None:
    buffer = PointBuffer()
    p = np.array([[np.nan, 0.0, 0.0], [1e30, -1e30, 0.0], [0.0, np.inf, 0.0], [1.0, 2.0, 3.0]])
    assert buffer.add(p, grey(p)) == 2
    assert buffer.since(0)[0].tolist() == [[np.float32(1e30), np.float32(-1e30), 0.0], [1.0, 2.0, 3.0]]


def test_a_finished_navigation_shows_all_its_landmarks() -> None:
    p = np.zeros((3, 3))
    assert len(PointBuffer.holding(p, np.zeros((3, 3), np.uint8)).since(1)[0]) == 2


def update_with(points: FloatArray) -> SlamUpdate:
    return SlamUpdate(1, "tracking", "", None, 0, False, points)


def test_readers_hear_of_another_cloud_when_points_are_numbered_anew_and_only_then() -> None:
    live = LiveSlam("nav-1")
    live.points = PointBuffer(100)
    assert live.update(update_with(some_points(90)))
    assert not live.update(update_with(some_points(90)))  # nothing to fetch
    assert live.source == "nav-1"
    assert live.update(update_with(some_points(90, seed=1)))
    other = live.source
    assert other != "nav-1" and other.startswith("nav-1/")
    live.restart()
    assert live.source not in ("nav-1", other)


def test_readers_hear_of_points_that_were_only_left_out() -> None:
    live = LiveSlam("nav-1")
    live.points = PointBuffer(1)
    assert live.update(update_with(np.zeros((1, 3))))
    assert live.update(update_with(np.full((1, 3), 0.1)))  # both are in one cell now: there is no new one
    assert len(live.points) == 1 and live.source != "nav-1"


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


def test_landmarks_of_hours_take_the_memory_of_the_first_minute() -> None:
    """As SLAM gives them: they scatter about what is there, so that there are ever new ones."""
    live = LiveSlam("nav-1")

    def drive(first: int, num_updates: int) -> None:
        for number in range(first, first + num_updates):
            live.update(update_with(some_points(1500, number)))

    assert grown_bytes(lambda: drive(0, 2), lambda: drive(2, 100)) < 10_000
    assert live.source != "nav-1"  # it was full
