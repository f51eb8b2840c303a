"""So many at a time, and nobody for ever."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from station.workers.promptness import ask_for_short_turns
from station.workers.turns import Turns


async def test_only_so_many_have_a_turn_and_in_their_order() -> None:
    turns, now, most, order = Turns(2, turn_s=1000.0), 0, 0, list[int]()

    async def work(number: int) -> None:
        nonlocal now, most
        async with turns.turn():
            order.append(number)
            now += 1
            most = max(most, now)
            await asyncio.sleep(0.001)
            now -= 1

    await asyncio.gather(*(work(number) for number in range(10)))
    assert most == 2 and order == list(range(10))


async def test_one_that_hangs_keeps_nobody() -> None:
    turns, never = Turns(1, turn_s=0.01), asyncio.Event()

    async def hang() -> None:
        async with turns.turn():
            await never.wait()

    hanging = [asyncio.create_task(hang()) for _ in range(3)]
    async with asyncio.timeout(60), turns.turn():
        never.set()
    await asyncio.gather(*hanging)
    async with asyncio.timeout(60), turns.turn():  # what was given back early is not given back again
        assert turns._free.locked()


async def test_a_turn_ends_with_an_error_or_a_cancellation() -> None:
    turns = Turns(1, turn_s=1000.0)
    with pytest.raises(ValueError, match="broken"):
        async with turns.turn():
            raise ValueError("broken")
    async with turns.turn():
        waiting = asyncio.create_task(turns.turn().__aenter__())
        await asyncio.sleep(0)
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)
    async with asyncio.timeout(60), turns.turn():
        pass


@pytest.mark.skipif(not Path("/proc/self/sched").is_file(), reason="the kernel does not show the length of a turn")
def test_the_loops_turns_are_short_where_the_kernel_can() -> None:
    if not ask_for_short_turns():
        pytest.skip("this kernel cannot")
    shown = Path("/proc/self/sched").read_text()
    if "se.slice" in shown:  # Linux 6.12 and later
        assert next(line for line in shown.splitlines() if line.startswith("se.slice")).split()[-1] == "500000"
