"""What happens in the station, told to whoever listens: a hub per robot, the newest state per topic, a log in words."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from station.mailbox import MessageHub

EventKind = Literal["robot", "driver", "pose", "landmarks", "navigation", "map", "job", "place", "bin", "log"]
Level = Literal["info", "warning", "error"]
KEPT_LOG_LINES = 200


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


class Teller(Protocol):
    """What a part of the station needs to say what happens in it."""

    def changed(self, kind: EventKind, subject: object = None, key: str = "") -> None:
        """Something has a new state; of a kind (and key) only the newest counts."""
        ...

    def forget(self, kind: EventKind, key: str) -> None:
        """It does not exist any more."""
        ...

    def say(self, topic: str, text: str, level: Level = "info") -> None:
        """A line for the log; every reader gets every line."""
        ...


class Events:
    """The hub and the log of one robot. A Teller."""

    def __init__(self) -> None:
        self.hub: MessageHub[Event] = MessageHub()
        self.log: deque[LogLine] = deque(maxlen=KEPT_LOG_LINES)
        self.on_line: Callable[[LogLine], None] = lambda _: None  # set by who keeps the lines
        self._number = 0

    def changed(self, kind: EventKind, subject: object = None, key: str = "") -> None:
        self.hub.put(Event(kind, subject), topic=f"{kind} {key}")

    def forget(self, kind: EventKind, key: str) -> None:
        self.hub.forget(f"{kind} {key}")

    def say(self, topic: str, text: str, level: Level = "info") -> None:
        self._number += 1
        line = LogLine(self._number, time.time(), level, topic, text)
        self.log.append(line)
        self.hub.put(Event("log", line))
        self.on_line(line)


class EventsOfAll:
    """What concerns no single robot is told to the readers of each. A Teller."""

    def __init__(self) -> None:
        self.robots: list[Events] = []

    def changed(self, kind: EventKind, subject: object = None, key: str = "") -> None:
        for events in self.robots:
            events.changed(kind, subject, key)

    def forget(self, kind: EventKind, key: str) -> None:
        for events in self.robots:
            events.forget(kind, key)

    def say(self, topic: str, text: str, level: Level = "info") -> None:
        for events in self.robots:
            events.say(topic, text, level)
