"""Where the robot is, in words."""

from __future__ import annotations

import pytest

from station.model.place_answer import SURE, RoomCandidate, one_of_two, where
from station.places.tracking.config import BeliefConfig


@pytest.mark.parametrize(
    ("place", "room", "words"),
    [
        ("Sofa", "Living room", "at Sofa in Living room"),
        ("Kitchen table", "Kitchen", "at Kitchen table in Kitchen"),
        ("Kitchen · 2", "Kitchen", "at Kitchen · 2"),
        ("Kitchen · door to Room 1", "Kitchen", "at Kitchen · door to Room 1"),
        ("Kitchen · door to Room 1", "Room 1", "in Room 1, near Kitchen · door to Room 1"),
        ("Room 12 · 2", "Room 1", "in Room 1, near Room 12 · 2"),
        ("Kitchen", "Kitchen", "at Kitchen"),
        ("Sofa", "", "at Sofa"),
        ("", "Kitchen", "in Kitchen"),
        ("", "", ""),
    ],
)
def test_a_place_is_said_to_be_in_the_room_that_the_robot_is_in(place: str, room: str, words: str) -> None:
    assert where(place, room) == words


@pytest.mark.parametrize(
    ("shares", "two"),
    [
        ((0.52, 0.46), 2),
        ((0.7, 0.2, 0.02), 2),
        ((0.36, 0.24), 0),  # mere prior of a map of two rooms
        ((0.34, 0.33, 0.33), 0),
        ((0.79, 0.03), 0),
        ((0.79,), 0),
        ((), 0),
    ],
)
def test_two_rooms_are_said_where_it_is_surely_one_of_them(shares: tuple[float, ...], two: int) -> None:
    rooms = tuple(RoomCandidate(f"room-{k}", f"Room {k}", share) for k, share in enumerate(shares))
    assert one_of_two(rooms) == rooms[:two]


def test_two_rooms_are_as_sure_together_as_one_that_is_named() -> None:
    assert BeliefConfig().known_from == SURE
