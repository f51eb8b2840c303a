"""What waits for a busy worker: in order, up to a limit for each kind, and what had to go is counted."""

from __future__ import annotations

from station.workers.outbox import Outbox
from station.workers.request import MAX_WAITING, Limit


async def test_the_oldest_of_a_full_kind_is_dropped_and_no_other() -> None:
    outbox: Outbox[int] = Outbox()
    for n in range(4):
        outbox.put("frame", n, Limit(2))
        outbox.put("imu", 10 + n, Limit())
    assert [await outbox.get() for _ in range(6)] == [10, 11, 2, 12, 3, 13]
    assert outbox.dropped["frame"] == 2 and outbox.dropped["imu"] == 0
    outbox.close()
    assert await outbox.get() is None


async def test_a_kind_that_nobody_gave_a_limit_has_one() -> None:
    outbox: Outbox[int] = Outbox()
    assert [outbox.put("drive", n, Limit()) for n in range(MAX_WAITING)] == [True] * MAX_WAITING
    assert not outbox.put("drive", MAX_WAITING, Limit())
    assert outbox.dropped["drive"] == 1 and await outbox.get() == 1


async def test_what_waits_too_long_goes_when_the_next_of_its_kind_comes_and_nothing_else_does() -> None:
    now_s = [0.0]
    outbox: Outbox[str] = Outbox(lambda: now_s[0])
    frames, samples = Limit(10, age_s=5.0), Limit(10)
    assert outbox.put("frame", "f0", frames) and outbox.put("imu", "i0", samples) and outbox.put("frame", "f1", frames)
    now_s[0] = 5.5
    assert outbox.put("imu", "i1", samples)
    assert not outbox.put("frame", "f2", frames)
    assert outbox.dropped["frame"] == 2 and outbox.dropped["imu"] == 0
    assert [await outbox.get() for _ in range(3)] == ["i0", "i1", "f2"]
