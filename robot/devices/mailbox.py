"""Hands values from a device's thread to the one coroutine that waits for them."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Keeps the newest `limit` values; older ones are dropped."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._values: list[T] = []
        self._lock = threading.Lock()
        self._waiter: tuple[asyncio.AbstractEventLoop, asyncio.Future[None]] | None = None
        self._failure: Exception | None = None

    def put(self, value: T) -> None:
        """Add a value; callable from any thread."""
        with self._lock:
            self._values.append(value)
            del self._values[: -self._limit]
            self._wake()

    def fail(self, failure: Exception) -> None:
        """From now on `get` raises this once the values are read."""
        with self._lock:
            self._failure = failure
            self._wake()

    def recover(self) -> None:
        """The source works again."""
        with self._lock:
            self._failure = None

    async def get(self, at_most: int | None = None) -> list[T]:
        """Wait for at least one value and take the oldest `at_most`, or all."""
        while True:
            loop = asyncio.get_running_loop()
            with self._lock:
                if self._values:
                    count = len(self._values) if at_most is None else at_most
                    values, self._values = self._values[:count], self._values[count:]
                    return values
                if self._failure is not None:
                    raise self._failure
                future: asyncio.Future[None] = loop.create_future()
                self._waiter = (loop, future)
            await future

    def _wake(self) -> None:
        if self._waiter is None:
            return
        loop, future = self._waiter
        self._waiter = None
        with contextlib.suppress(RuntimeError):  # the loop has been closed: nobody waits any more
            loop.call_soon_threadsafe(_resolve, future)


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
