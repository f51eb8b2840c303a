"""A slow reader gets the newest state, and no more lines than it may keep waiting."""

from __future__ import annotations

import asyncio

import pytest

from station.events import Latest, MessageHub


async def test_latest_gives_the_newest_and_counts_the_others() -> None:
    box: Latest[int] = Latest()
    for n in range(3):
        box.put(n)
    assert await box.get() == 2 and box.skipped == 2


async def test_a_new_reader_gets_the_state_and_a_slow_one_only_the_newest() -> None:
    hub: MessageHub[str] = MessageHub()
    hub.put("old", "robot")
    hub.put("new", "robot")
    with hub.subscribe() as reader:
        assert await reader.get() == "new"
        for n in range(1000):
            hub.put(f"pose {n}", "pose")
            hub.put(f"line {n}")
        lines = [await reader.get() for _ in range(256)]
        assert lines[-1] == "line 999" and reader.lost == 1000 - 256
        assert await reader.get() == "pose 999"
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.01):
                await reader.get()
    assert hub.num_readers == 0
