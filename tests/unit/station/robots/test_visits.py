"""The time line's log: where the robot is, in words that do not contradict each other."""

from __future__ import annotations

import numpy as np
import pytest

from station.events import Events
from station.model.place_answer import PlaceAnswer, PlaceCandidate, RoomCandidate
from station.robots.visits import Visits

HALL = RoomCandidate("room-h", "Hall", 0.95)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (PlaceCandidate("a", "Hall · 2", 0.9, "room-h"), "at Hall · 2 (90%)"),
        (PlaceCandidate("b", "Coats", 0.9, "room-h"), "at Coats in Hall (90%)"),
        (PlaceCandidate("c", "Kitchen · door to Hall", 0.9, "room-k"), "in Hall, near the door to Kitchen (95%)"),
        (PlaceCandidate("d", "Fridge", 0.9, "room-k"), "in Hall (95%)"),
        (PlaceCandidate("e", "Place 3", 0.9, None), "at Place 3 in Hall (90%)"),
    ],
)
def test_a_visit_to_a_place_of_another_room_is_told_as_one_to_the_room(place: PlaceCandidate, words: str) -> None:
    events = Events()
    Visits(events).add(PlaceAnswer("known", place, 0.5, np.zeros(3), 1, 1, 3, 40, (), "seen", room=HALL))
    assert [line.text for line in events.log] == [words]
