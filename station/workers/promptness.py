"""Short turns on the processor for the thread that carries the messages, where the system offers them."""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import sys

logger = logging.getLogger(__name__)
SLICE_NS = 500_000  # it works for less than this at a time, and then waits for the next message
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # numbers of the call, which Python does not offer
RESET_ON_FORK = 1  # threads and processes made by this one have ordinary turns (and no negative niceness of its)


class _Attributes(ctypes.Structure):
    """struct sched_attr. Source: sched_setattr(2)."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),  # of SCHED_OTHER since Linux 6.12: the length of a turn, ns
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def ask_for_short_turns() -> bool:
    """Let this thread, when a message comes, go before those that are in the middle of a longer turn.

    It gets no more time in all than before. Since Linux 6.6 a busy process is left to end its turn of some
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
        logger.info("no short turns for the event loop (%s)", os.strerror(ctypes.get_errno()))
        return False
    return True
