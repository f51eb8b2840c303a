"""So many at a time, and nobody for ever."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from station.workers.scheduling import ComputeSlots, request_short_slices


async def test_only_so_many_compute_and_in_their_order() -> None:
    slots, now, most, order = ComputeSlots(2, max_hold_s=1000.0), 0, 0, list[int]()

    async def work(number: int) -> None:
        nonlocal now, most
        async with slots.hold():
            order.append(number)
            now += 1
            most = max(most, now)
            await asyncio.sleep(0.001)
            now -= 1

    await asyncio.gather(*(work(number) for number in range(10)))
    assert most == 2 and order == list(range(10))


async def test_one_that_hangs_keeps_nobody() -> None:
    slots, never = ComputeSlots(1, max_hold_s=0.01), asyncio.Event()

    async def hang() -> None:
        async with slots.hold():
            await never.wait()

    hanging = [asyncio.create_task(hang()) for _ in range(3)]
    async with asyncio.timeout(60), slots.hold():
        never.set()
    await asyncio.gather(*hanging)
    async with asyncio.timeout(60), slots.hold():  # what was given back early is not given back again
        assert slots._free.locked()


async def test_a_slot_is_given_back_after_an_error_or_a_cancellation() -> None:
    slots = ComputeSlots(1, max_hold_s=1000.0)
    with pytest.raises(ValueError, match="broken"):
        async with slots.hold():
            raise ValueError("broken")
    async with slots.hold():
        waiting = asyncio.create_task(slots.hold().__aenter__())
        await asyncio.sleep(0)
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)
    async with asyncio.timeout(60), slots.hold():
        pass


@pytest.mark.skipif(not Path("/proc/self/sched").is_file(), reason="the kernel does not show the length of a slice")
def test_the_loops_slices_are_short_where_the_kernel_can() -> None:
    if not request_short_slices():
        pytest.skip("this kernel cannot")
    shown = Path("/proc/self/sched").read_text()
    if "se.slice" in shown:  # Linux 6.12 and later
        assert next(line for line in shown.splitlines() if line.startswith("se.slice")).split()[-1] == "500000"
