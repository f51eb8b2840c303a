"""What stays in memory when something was done."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable


def grown_bytes(warm_up: Callable[[], object], act: Callable[[], object]) -> int:
    """By how much the memory of Python's objects, arrays too, grows with `act` after `warm_up` has filled queues."""
    tracemalloc.start()
    try:
        warm_up()
        gc.collect()
        before, _ = tracemalloc.get_traced_memory()
        act()
        gc.collect()
        return tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()


def peak_bytes(act: Callable[[], object]) -> int:
    """How much memory of Python's objects, arrays too, `act` takes at most beyond what there was before."""
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        act()
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
