"""What the link delivers out of order leaves in the order of the sensors' clock."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.motion.sensor_order import HOLD_BACK_NS, Sequencer

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
