"""What happens in the station, told to whoever listens: a hub per robot, the newest state per topic, a log in words."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar

EventKind = Literal[
    "robot", "driver", "pose", "landmarks", "navigation", "map", "job", "place", "bin", "calibration", "log"
]
Level = Literal["info", "warning", "error"]
KEPT_LOG_LINES = 200
MAX_WAITING_MESSAGES = 256  # per reader: more than a minute of ordinary events
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class LogLine:
    """Something a person may want to know, in a sentence."""

    number: int
    t_wall_s: float  # seconds since 1970
    level: Level
    topic: str  # "link", "slam", "place", "hijack", "drive", "map", "worker"
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Event:
    """A change. `subject` is what changed, where the kind alone does not say it."""

    kind: EventKind
    subject: object = None


class Notifier(Protocol):
    """What a part of the station needs to say what happens in it."""

    def changed(self, kind: EventKind, subject: object = None, key: str = "") -> None:
        """Something has a new state; of a kind (and key) only the newest counts."""
        ...

    def forget(self, kind: EventKind, key: str) -> None:
        """What has this key does not exist any more."""
        ...

    def notify(self, topic: str, text: str, level: Level = "info") -> None:
        """A line for the log; every reader gets every line."""
        ...


class Events:
    """The hub and the log of one robot. A Notifier."""

    def __init__(self) -> None:
        self.hub: MessageHub[Event] = MessageHub()
        self.log: deque[LogLine] = deque(maxlen=KEPT_LOG_LINES)
        self.on_line: Callable[[LogLine], None] = lambda _: None  # set by who keeps the lines
        self._number = 0

    def changed(self, kind: EventKind, subject: object = None, key: str = "") -> None:
        self.hub.put(Event(kind, subject), topic=f"{kind} {key}")

    def forget(self, kind: EventKind, key: str) -> None:
        self.hub.forget(f"{kind} {key}")

    def notify(self, topic: str, text: str, level: Level = "info") -> None:
        self._number += 1
        line = LogLine(self._number, time.time(), level, topic, text)
        self.log.append(line)
        self.hub.put(Event("log", line))
        self.on_line(line)


class EventsOfAll:
    """What concerns no single robot is told to the readers of each. A Notifier."""

    def __init__(self) -> None:
        self.robots: list[Events] = []

    def changed(self, kind: EventKind, subject: object = None, key: str = "") -> None:
        for events in self.robots:
            events.changed(kind, subject, key)

    def forget(self, kind: EventKind, key: str) -> None:
        for events in self.robots:
            events.forget(kind, key)

    def notify(self, topic: str, text: str, level: Level = "info") -> None:
        for events in self.robots:
            events.notify(topic, text, level)


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
