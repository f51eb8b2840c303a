"""What the link delivers out of order leaves in the order of the sensors' clock."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.errors import DataError
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.motion.sensor_order import HOLD_BACK_NS, MAX_HELD_SAMPLES, Sequencer

MS = 1_000_000


@given(
    frames=st.lists(st.integers(0, 2000), unique=True, min_size=1, max_size=30).map(sorted),
    batch_ms=st.integers(5, 40),
    shift_ms=st.integers(-50, 50),
    late=st.lists(st.integers(0, 3), min_size=30, max_size=30),
)
def test_sequencer_gives_everything_in_sensor_time_order(
    frames: list[int], batch_ms: int, shift_ms: int, late: list[int]
) -> None:
    sequencer = Sequencer(shift_ms / 1e3, has_imu=True)
    out: list[ImuBatch | DriveSample | ImageFrame] = []
    waiting = list(frames)
    for start in range(0, 2200, batch_ms):
        while waiting and waiting[0] <= start - late[len(waiting) % 30]:
            sequencer.add_frame(ImageFrame(0, waiting.pop(0) * MS, 0, b""))
            out += sequencer.ready()
        t = np.arange(start, start + batch_ms, 5, dtype=np.int64) * MS
        sequencer.add_imu(ImuBatch(t, np.zeros((len(t), 3)), np.zeros((len(t), 3))))
        out += sequencer.ready()
    out += sequencer.rest()
    times = [np.array([i.t_robot_ns + shift_ms * MS]) if isinstance(i, ImageFrame) else i.t_robot_ns for i in out]
    merged = np.concatenate([np.atleast_1d(t) for t in times])
    assert (np.diff(merged) >= 0).all()
    assert [i.t_robot_ns // MS for i in out if isinstance(i, ImageFrame)] == frames
    samples = sum(len(i) for i in out if isinstance(i, ImuBatch))
    assert samples == sum(len(range(s, s + batch_ms, 5)) for s in range(0, 2200, batch_ms))


def test_frames_go_on_without_imu_when_it_is_silent() -> None:
    sequencer = Sequencer(0.0, has_imu=True)
    for n in range(100):
        sequencer.add_frame(ImageFrame(n, n * 33 * MS, 0, b""))
    assert len(list(sequencer.ready())) >= 30
    without = Sequencer(0.0, has_imu=False)
    without.add_frame(ImageFrame(0, 0, 0, b""))
    assert list(without.ready()) == []
    without.add_frame(ImageFrame(1, HOLD_BACK_NS, 0, b""))
    assert len(list(without.ready())) == 1


def inertial(*t_ms: int) -> ImuBatch:
    t = np.array(t_ms, dtype=np.int64) * MS
    return ImuBatch(t, np.zeros((len(t), 3)), np.zeros((len(t), 3)))


def fill(sequencer: Sequencer, t_ms: int) -> None:
    """With samples that all have this time."""
    for _ in range(MAX_HELD_SAMPLES // 250):
        sequencer.add_imu(inertial(*[t_ms] * 250))


def times_ms(items: Iterable[ImuBatch | DriveSample | ImageFrame]) -> set[int]:
    return {t // MS for item in items if isinstance(item, ImuBatch) for t in item.t_robot_ns.tolist()}


def test_samples_that_no_picture_will_ever_reach_are_left_out_and_others_go_on() -> None:
    sequencer = Sequencer(0.0, has_imu=True)
    sequencer.add_frame(ImageFrame(0, 100 * MS, 0, b""))
    with pytest.raises(DataError, match=r"more than 60 s after every picture .* clocks disagree"):
        sequencer.add_imu(inertial(10**12))
    with pytest.raises(DataError, match="more than 60 s after every picture"):
        sequencer.add_drive(DriveSample(10**18, 0.0, 0.0))
    sequencer.add_imu(inertial(90, 95, 200))
    assert times_ms(sequencer.ready()) == {90, 95}
    assert times_ms(sequencer.rest()) == {200}


def test_memory_is_bounded_while_no_picture_comes_and_the_newest_samples_stay() -> None:
    sequencer = Sequencer(0.0, has_imu=True)
    fill(sequencer, 1000)
    with pytest.raises(DataError, match="60000 samples waited for a picture; the oldest are left out"):
        sequencer.add_imu(inertial(*[2000] * 250))
    left = list(sequencer.rest())
    assert 0.8 * MAX_HELD_SAMPLES < sum(len(item) for item in left if isinstance(item, ImuBatch)) <= MAX_HELD_SAMPLES
    assert times_ms(left) == {1000, 2000}


def test_what_was_dated_far_ahead_before_the_first_picture_gives_its_room_to_the_rest() -> None:
    sequencer = Sequencer(0.0, has_imu=True)
    fill(sequencer, 10**12)
    sequencer.add_frame(ImageFrame(0, 100 * MS, 0, b""))
    with pytest.raises(DataError, match="left out"):
        sequencer.add_imu(inertial(90))
    sequencer.add_imu(inertial(95, 200))
    assert times_ms(sequencer.ready()) == {90, 95}


def frames_ms(items: Iterable[ImuBatch | DriveSample | ImageFrame]) -> list[int]:
    return [item.t_robot_ns // MS for item in items if isinstance(item, ImageFrame)]


def test_one_picture_dated_far_ahead_does_not_take_the_place_of_all_that_follow() -> None:
    sequencer = Sequencer(0.0, has_imu=True)
    sequencer.add_frame(ImageFrame(0, 0, 0, b""))
    sequencer.add_frame(ImageFrame(1, 10**12 * MS, 0, b""))
    with pytest.raises(DataError, match="the camera's clock jumped"):
        sequencer.add_frame(ImageFrame(2, 100 * MS, 0, b""))
    sequencer.add_frame(ImageFrame(3, 200 * MS, 0, b""))
    sequencer.add_imu(inertial(90, 300))
    assert frames_ms(sequencer.ready()) == [0, 100, 200]


def test_pictures_that_come_after_one_that_went_on_with_a_wrong_date_are_said_to_be_left_out() -> None:
    sequencer = Sequencer(0.0, has_imu=True)
    sequencer.add_frame(ImageFrame(0, 10**8 * MS, 0, b""))
    sequencer.add_imu(inertial(10**8 + 100))
    assert frames_ms(sequencer.ready()) == [10**8]
    with pytest.raises(DataError, match="some are left out"):
        sequencer.add_frame(ImageFrame(1, 100 * MS, 0, b""))
    assert frames_ms(sequencer.rest()) == []
