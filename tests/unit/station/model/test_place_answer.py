"""Where the robot is, in words."""

from __future__ import annotations

import pytest

from station.model.place_answer import is_elsewhere, where


@pytest.mark.parametrize(
    ("place", "room", "words"),
    [
        ("Sofa", "Living room", "at Sofa in Living room"),
        ("Kitchen table", "Kitchen", "at Kitchen table in Kitchen"),
        ("Kitchen · 2", "Kitchen", "at Kitchen · 2"),
        ("Kitchen · door to Room 1", "Kitchen", "at Kitchen · door to Room 1"),
        ("Kitchen", "Kitchen", "at Kitchen"),
        ("Sofa", "", "at Sofa"),
        ("", "Kitchen", "in Kitchen"),
        ("", "", ""),
    ],
)
def test_a_place_is_said_to_be_in_the_room_that_the_robot_is_in(place: str, room: str, words: str) -> None:
    assert where(place, room) == words


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("Kitchen · door to Room 1", "in Room 1, near the door to Kitchen"),
        ("Kitchen · door to Room 12", "in Room 1"),
        ("Room 12 · 2", "in Room 1"),
        ("Fridge", "in Room 1"),
    ],
)
def test_a_place_of_another_room_is_told_by_the_door_between_both_or_not_at_all(place: str, words: str) -> None:
    assert where(place, "Room 1", is_elsewhere=True) == words


@pytest.mark.parametrize(
    ("place_room", "room", "is_so"),
    [("a", "b", True), ("a", "a", False), (None, "b", False), ("a", None, False), (None, None, False)],
)
def test_a_place_is_elsewhere_only_where_both_rooms_are_known(
    place_room: str | None, room: str | None, is_so: bool
) -> None:
    assert is_elsewhere(place_room, room) is is_so
