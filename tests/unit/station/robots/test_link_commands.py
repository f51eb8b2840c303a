"""What goes to the robot first, and what is never sent."""

from __future__ import annotations

import asyncio

from shared.messages import Drive, Heartbeat, PanTilt, Stop
from station.robots.link_commands import DueMessages


def drive(seq: int) -> Drive:
    return Drive(seq=seq, t_station_ns=0, linear=0.1, angular=0.0, ttl_ms=200)


async def test_a_stop_goes_first_and_of_each_kind_only_the_newest() -> None:
    due = DueMessages()
    for message in (Heartbeat(seq=1, t_station_ns=0), drive(2), PanTilt(pan=0.0, tilt=0.0), drive(3), Stop(seq=4)):
        due.put(message)
    async with asyncio.timeout(60):
        await due.wait()
    sent = [due.pop() for _ in range(5)]
    assert [type(message) for message in sent] == [Stop, Drive, PanTilt, Heartbeat, type(None)]
    assert sent[1] == drive(3)


def test_what_is_discarded_is_not_sent() -> None:
    due = DueMessages()
    due.put(drive(1))
    due.discard(Drive)
    assert due.pop() is None
