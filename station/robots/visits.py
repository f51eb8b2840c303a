"""The time line of a robot: where it was, and for how long."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from station.events import Notifier
from station.model.place_answer import PlaceAnswer, PlaceState

MAX_VISITS = 200


@dataclass(frozen=True, slots=True)
class Visit:
    """A stretch of time with one answer."""

    state: PlaceState
    place_id: str | None
    place_name: str
    start_wall_s: float
    end_wall_s: float


class Visits:
    """The last of them, oldest first."""

    def __init__(self, events: Notifier) -> None:
        self._events = events
        self._visits: deque[Visit] = deque(maxlen=MAX_VISITS)

    def __iter__(self) -> Iterator[Visit]:
        return iter(self._visits)

    @property
    def last(self) -> Visit | None:
        return self._visits[-1] if self._visits else None

    def add(self, answer: PlaceAnswer) -> None:
        """The place at present; a line in the log where it is another one than before."""
        now_s = time.time()
        place_id = answer.place.id if answer.place else None
        name = answer.place.name if answer.place else ""
        last = self.last
        if last is not None and (last.state, last.place_id) == (answer.state, place_id):
            self._visits[-1] = Visit(last.state, place_id, name, last.start_wall_s, now_s)
            return
        self._visits.append(Visit(answer.state, place_id, name, now_s, now_s))
        if answer.state == "known":
            self._events.notify("place", f"at {name} ({answer.place.probability:.0%})" if answer.place else "known")
        elif last is not None:
            self._events.notify("place", answer.reason, "warning" if answer.state == "lost" else "info")
