"""Bounded ways to hand values to tasks of the event loop: nobody who is slow holds up anybody else."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

T = TypeVar("T")

MAX_WAITING_MESSAGES = 256  # per reader: more than a minute of ordinary events


class Latest(Generic[T]):
    """Mailbox of one, one reader: a slow reader gets the newest value and skips the others."""

    def __init__(self) -> None:
        self._value: list[T] = []
        self._fresh = asyncio.Event()
        self.skipped = 0

    def put(self, value: T) -> None:
        self.skipped += self._fresh.is_set()
        self._value = [value]
        self._fresh.set()

    @property
    def is_fresh(self) -> bool:
        """Whether `get` would return at once."""
        return self._fresh.is_set()

    async def get(self) -> T:
        await self._fresh.wait()
        self._fresh.clear()
        return self._value[0]


class Broadcast(Generic[T]):
    """One writer, many readers, each with a mailbox of one; remembers the newest value."""

    def __init__(self) -> None:
        self.newest: T | None = None
        self._readers: set[Latest[T]] = set()

    @property
    def num_readers(self) -> int:
        return len(self._readers)

    def put(self, value: T) -> None:
        self.newest = value
        for reader in self._readers:
            reader.put(value)

    @contextmanager
    def subscribe(self) -> Iterator[Latest[T]]:
        """A mailbox that gets every value from now on, beginning with the newest there is."""
        reader: Latest[T] = Latest()
        if self.newest is not None:
            reader.put(self.newest)
        self._readers.add(reader)
        try:
            yield reader
        finally:
            self._readers.discard(reader)


class MessageReader(Generic[T]):
    """Messages for one reader. One with a topic replaces its older one; others wait in line, the oldest lost first."""

    def __init__(self) -> None:
        self._topics: OrderedDict[str, T] = OrderedDict()
        self._line: deque[T] = deque(maxlen=MAX_WAITING_MESSAGES)
        self._fresh = asyncio.Event()
        self.lost = 0

    def put(self, message: T, topic: str) -> None:
        if topic:
            self._topics[topic] = message
        else:
            self.lost += len(self._line) == MAX_WAITING_MESSAGES
            self._line.append(message)
        self._fresh.set()

    async def get(self) -> T:
        await self._fresh.wait()
        message = self._line.popleft() if self._line else self._topics.popitem(last=False)[1]
        if not self._line and not self._topics:
            self._fresh.clear()
        return message


class MessageHub(Generic[T]):
    """Messages to any number of readers. A new reader first gets the newest of each topic: the state of things."""

    def __init__(self) -> None:
        self._newest: OrderedDict[str, T] = OrderedDict()
        self._readers: set[MessageReader[T]] = set()

    @property
    def num_readers(self) -> int:
        return len(self._readers)

    def put(self, message: T, topic: str = "") -> None:
        """Hand on a message; of a topic only the newest counts."""
        if topic:
            self._newest[topic] = message
        for reader in self._readers:
            reader.put(message, topic)

    def forget(self, topic: str) -> None:
        """New readers need not know of this topic any more."""
        self._newest.pop(topic, None)

    @contextmanager
    def subscribe(self) -> Iterator[MessageReader[T]]:
        reader: MessageReader[T] = MessageReader()
        for topic, message in self._newest.items():
            reader.put(message, topic)
        self._readers.add(reader)
        try:
            yield reader
        finally:
            self._readers.discard(reader)
