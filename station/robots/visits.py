"""The time line of a robot: where it was, and for how long."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

from station.events import Notifier
from station.model.place_answer import PlaceAnswer, PlaceState, is_elsewhere, where

MAX_VISITS = 200


@dataclass(frozen=True, slots=True)
class Visit:
    """A stretch of time with one answer."""

    state: PlaceState
    place_id: str | None
    place_name: str
    place_room: str | None  # id of the room that the place is in
    room_id: str | None  # may be known where the place is not
    room_name: str
    start_wall_s: float
    end_wall_s: float

    @property
    def place_elsewhere(self) -> bool:
        return is_elsewhere(self.place_room, self.room_id)


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
        """Place and room at present; a line in the log where they are others than before."""
        now_s = time.time()
        place, room = answer.place, answer.room
        visit = Visit(
            answer.state,
            place.id if place else None,
            place.name if place else "",
            place.room if place else None,
            room.id if room else None,
            room.name if room else "",
            now_s,
            now_s,
        )
        last = self.last
        if last is not None and (last.state, last.place_id, last.room_id) == (
            visit.state, visit.place_id, visit.room_id
        ):  # fmt: skip
            self._visits[-1] = replace(visit, start_wall_s=last.start_wall_s)
            return
        self._visits.append(visit)
        likeliest = place or room
        if likeliest is not None:
            words = where(visit.place_name, visit.room_name, visit.place_elsewhere)
            sure = room if room is not None and visit.place_elsewhere else likeliest
            self._events.notify("place", f"{words} ({sure.probability:.0%})")
        elif last is not None:
            self._events.notify("place", answer.reason, "warning" if answer.state == "lost" else "info")
