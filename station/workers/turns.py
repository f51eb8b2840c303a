"""Who may compute now: with twenty busy workers on two cores nobody is served soon, least of all the event loop."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

TURN_S = 15.0  # one that hangs keeps the others no longer than this; on a busy machine an answer takes seconds


class Turns:
    """So many at a time, first come first served. All methods belong on the event loop."""

    def __init__(self, at_a_time: int | None = None, turn_s: float = TURN_S) -> None:
        """Without a number: as many as there are cores, but one."""
        self._free = asyncio.Semaphore(at_a_time or max(1, (os.cpu_count() or 2) - 1))
        self._turn_s = turn_s

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Wait for a turn, and give it back at the end, or when it has lasted too long."""
        await self._free.acquire()
        is_over = False

        def end() -> None:
            nonlocal is_over
            if not is_over:
                is_over = True
                self._free.release()

        too_long = asyncio.get_running_loop().call_later(self._turn_s, end)
        try:
            yield
        finally:
            too_long.cancel()
            end()
