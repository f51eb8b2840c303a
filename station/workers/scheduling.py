"""Who computes when, with twenty busy workers on two cores: none is served late, least of all the event loop."""

from __future__ import annotations

import asyncio
import ctypes
import logging
import os
import platform
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

logger = logging.getLogger(__name__)
MAX_HOLD_S = 15.0  # one that hangs keeps the others no longer than this; on a busy machine an answer takes seconds
SLICE_NS = 500_000  # the event loop works for less than this at a time, and then waits for the next message
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # numbers of the call, which Python does not offer
RESET_ON_FORK = 1  # threads and processes made by this one have ordinary slices (and no negative niceness of its)


class ComputeSlots:
    """So many may compute at a time, first come first served. All methods belong on the event loop."""

    def __init__(self, at_a_time: int | None = None, max_hold_s: float = MAX_HOLD_S) -> None:
        """Without a number: as many as there are cores, but one."""
        self._free = asyncio.Semaphore(at_a_time or max(1, (os.cpu_count() or 2) - 1))
        self._max_hold_s = max_hold_s

    @asynccontextmanager
    async def hold(self) -> AsyncIterator[None]:
        """Wait for a slot, and give it back at the end, or when it was held for too long."""
        await self._free.acquire()
        is_over = False

        def release() -> None:
            nonlocal is_over
            if not is_over:
                is_over = True
                self._free.release()

        too_long = asyncio.get_running_loop().call_later(self._max_hold_s, release)
        try:
            yield
        finally:
            too_long.cancel()
            release()


class _Attributes(ctypes.Structure):
    """struct sched_attr. Source: sched_setattr(2)."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),  # of SCHED_OTHER since Linux 6.12: the length of a slice, ns
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def request_short_slices() -> bool:
    """Let this thread, when a message comes, go before those that are in the middle of a longer time slice.

    It gets no more time in all than before. Since Linux 6.6 a busy process is left to end its slice of some
    milliseconds, whatever its niceness; behind ten of them a message waits for a tenth of a second. False where the
    system cannot do it.
    """
    number = SCHED_SETATTR.get(platform.machine())
    if sys.platform != "linux" or number is None or sys.maxsize < 2**32:
        return False
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = _Attributes(ctypes.sizeof(_Attributes), os.SCHED_OTHER, RESET_ON_FORK, nice, 0, SLICE_NS, 0, 0)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(number, 0, ctypes.byref(attributes), 0):
        logger.info("no short slices for the event loop (%s)", os.strerror(ctypes.get_errno()))
        return False
    return True
