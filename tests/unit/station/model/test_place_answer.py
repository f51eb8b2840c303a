"""Where the robot is, in words."""

from __future__ import annotations

import pytest

from station.model.place_answer import where


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
