"""The poses of all frames: kept in order, improved, dropped, moved along."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, se3
from station.slam.ukf.map.pose_log import ROWS, PoseLog


def at(x: float) -> FloatArray:
    return se3(np.eye(3), np.array([x, 0.0, 0.0]))


def straight(frames: int, turn: int) -> PoseLog:
    """A metre per frame, every second frame used; segment 1 from frame 2 * turn on."""
    log = PoseLog()
    for k in range(frames):
        log.add(2 * k, 50 * k, at(float(k)), int(k >= turn))
    return log


def x_of(log: PoseLog) -> FloatArray:
    return log.arrays()[1][:, 0, 3]


def test_a_long_drive_is_kept_whole() -> None:
    log = straight(2 * ROWS + 3, ROWS)
    times, _ = log.arrays()
    assert len(log) == 2 * ROWS + 3
    assert np.array_equal(times, 50 * np.arange(len(log)))
    assert np.array_equal(x_of(log), np.arange(len(log)))


@pytest.mark.parametrize(("frame", "t"), [(8, 1000), (100, 200), (9, 200)])
def test_what_is_not_later_is_left_out(frame: int, t: int) -> None:
    log = straight(5, 5)
    log.add(frame, t, at(-1.0), 0)
    assert np.array_equal(x_of(log), np.arange(5))


def test_a_known_pose_is_improved_and_an_unknown_one_is_not_made() -> None:
    log = straight(5, 5)
    log.improve(4, at(7.0))
    log.improve(5, at(9.0))
    log.improve(99, at(9.0))
    assert x_of(log).tolist() == [0.0, 1.0, 7.0, 3.0, 4.0]


def test_poses_of_an_outage_go_and_the_log_goes_on() -> None:
    log = straight(8, 4)
    log.drop_after(100, 1)  # what is of another segment stays, though it is late enough
    assert x_of(log).tolist() == [0.0, 1.0, 2.0, 3.0]
    log.improve(10, at(9.0))  # gone
    log.add(20, 900, at(20.0), 2)
    assert x_of(log).tolist() == [0.0, 1.0, 2.0, 3.0, 20.0]
    last = log.last()
    assert last is not None
    last[:] = 0.0  # belongs to who asked
    assert x_of(log)[-1] == 20.0


def test_a_segment_follows_its_keyframes_and_others_stay() -> None:
    log = straight(6, 3)
    old = np.array([at(3.0), at(5.0)])
    log.follow([6, 10], old, np.array([at(4.0), at(6.0)]), 1)
    assert np.allclose(x_of(log), [0.0, 1.0, 2.0, 4.0, 5.0, 6.0])
    log.follow([], np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), 1)
    assert len(log) == 6


def test_nothing_is_in_an_empty_log() -> None:
    assert PoseLog().last() is None and len(PoseLog()) == 0
    times, T = PoseLog().arrays()
    assert times.shape == (0,) and T.shape == (0, 4, 4)
