"""Requests on their way to a worker: a queue with a limit for each kind."""

from __future__ import annotations

import asyncio
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from station.workers.request import Limit

T = TypeVar("T")


class Outbox(Generic[T]):
    """Items of several kinds in the order in which they came. One reader.

    When a kind is full its oldest is dropped and counted. What waits longer than its kind may is dropped too, when the
    next one of its kind comes.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._queues: dict[Hashable, deque[tuple[int, float, T]]] = defaultdict(deque)  # number, when it came
        self._count = 0
        self._changed = asyncio.Event()  # something waits, or nothing will any more
        self._closed = False
        self.dropped: Counter[Hashable] = Counter()

    def put(self, kind: Hashable, item: T, limit: Limit) -> bool:
        """Add an item; False when older ones of its kind had to go."""
        now_s = self._now_s()
        queue = self._queues[kind]
        dropped = 0
        while queue and (len(queue) >= limit.count or now_s - queue[0][1] > limit.age_s):
            queue.popleft()
            dropped += 1
        self.dropped[kind] += dropped
        self._count += 1
        queue.append((self._count, now_s, item))
        self._changed.set()
        return not dropped

    async def get(self) -> T | None:
        """Wait for the next item; None when the outbox is closed."""
        while not self._closed:
            if waiting := [queue for queue in self._queues.values() if queue]:
                return min(waiting, key=lambda queue: queue[0][0]).popleft()[2]
            self._changed.clear()
            await self._changed.wait()
        return None

    def waiting(self, kind: Hashable) -> int:
        return len(self._queues[kind])

    def close(self) -> None:
        """Whoever waits, and whoever comes, gets None."""
        self._closed = True
        self._changed.set()
