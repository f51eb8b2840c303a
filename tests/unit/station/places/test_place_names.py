"""Places that no person named are called after their rooms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.model.floor_plan import FloorPlan
from station.model.place_map import Place
from station.places.rooms.place_names import named_by_rooms
from tests.support.plans import two_rooms


def place(number: int, x: float, name: str = "") -> Place:
    index = np.zeros(0, np.int64)
    return Place(f"p{number}", name or f"Place {number}", np.array([x, 1.0, 0.3]), 0.3, index, index, -1, 1.0)


def named_place(number: int, x: float, name: str) -> Place:
    return replace(place(number, x, name), named=True)


def plan_of(rooms: dict[str, str]) -> FloorPlan:
    return replace(two_rooms(), room_of_place=rooms)


def names(places: tuple[Place, ...]) -> list[str]:
    return [place.name for place in places]


def test_places_are_numbered_within_their_rooms() -> None:
    plan = plan_of({"p7": "room-k", "p8": "room-k", "p9": "room-l"})
    made = named_by_rooms([place(7, 5.0), place(8, 6.0), place(9, 0.0), place(12, 9.0)], plan)
    assert names(made) == ["Room 2 · 1", "Room 2 · 2", "Living room · 1", "Place 1"]
    assert not any(place.named for place in made)


def test_a_renamed_room_renames_its_places_and_each_keeps_its_number() -> None:
    plan = plan_of({"p1": "room-k", "p2": "room-k"})
    places = [place(1, 5.0, "Room 2 · 4"), place(2, 6.0, "Room 2 · 2")]
    renamed = replace(plan, rooms=(plan.rooms[0], replace(plan.rooms[1], name="Kitchen")))
    assert names(named_by_rooms(places, renamed)) == ["Kitchen · 4", "Kitchen · 2"]


def test_a_name_that_a_person_gave_stays_and_is_not_given_again() -> None:
    plan = plan_of({"p1": "room-k", "p2": "room-k"})
    assert names(named_by_rooms([named_place(1, 5.0, "Sofa"), place(2, 6.0)], plan)) == ["Sofa", "Room 2 · 1"]


def test_naming_twice_changes_nothing() -> None:
    plan = plan_of({f"p{n}": "room-k" if n % 2 else "room-l" for n in range(1, 9)})
    once = named_by_rooms([place(n, float(n)) for n in range(1, 9)], plan)
    assert names(named_by_rooms(once, plan)) == names(once)


def test_the_place_beside_the_only_door_is_called_by_it() -> None:
    plan = plan_of({"p1": "room-l", "p2": "room-l"})
    assert names(named_by_rooms([place(1, 0.0), place(2, 2.6)], plan)) == ["Living room · 1", "Living room · door side"]


@pytest.mark.parametrize("name", ["Shelf · 2", "Shelf · door side", "Place 7"])
def test_a_name_that_a_person_gave_stays_also_where_it_reads_as_a_made_up_one(name: str) -> None:
    plan = plan_of({"p1": "room-k", "p2": "room-k"})
    assert names(named_by_rooms([named_place(1, 5.0, name), place(2, 6.0)], plan)) == [name, "Room 2 · 1"]


def test_no_place_gets_the_name_that_a_person_gave_to_another() -> None:
    plan = plan_of({"p1": "room-l", "p2": "room-l", "p3": "room-l"})
    given = [named_place(1, 0.0, "Living room · door side"), named_place(3, 0.0, "living room · 1"), place(2, 2.6)]
    made = names(named_by_rooms(given, plan))
    assert made[:2] == ["Living room · door side", "living room · 1"] and made[2] == "Living room · 2"


def test_where_a_room_has_several_doors_each_says_where_it_leads() -> None:
    plan = plan_of({"p1": "room-k", "p2": "room-k", "p3": "room-k"})
    made = names(named_by_rooms([place(1, 3.4), place(2, 5.0), place(3, 6.6)], plan))
    assert made == ["Room 2 · door to Living room", "Room 2 · 1", "Room 2 · 2"]  # nobody went through the other one


def test_a_place_at_two_doors_is_called_by_neither() -> None:
    plan = plan_of({"p1": "room-k", "p2": "room-k"})
    second = replace(plan.doors[0], id="door-lk-2", ends=plan.doors[0].ends + np.array([0.0, 1.0]))
    made = named_by_rooms([place(1, 3.4), place(2, 6.0)], replace(plan, doors=(*plan.doors[:1], second)))
    assert names(made) == ["Room 2 · 1", "Room 2 · 2"]


def test_the_only_place_of_a_room_is_the_room_and_not_the_side_of_its_door() -> None:
    assert names(named_by_rooms([place(1, 2.6)], plan_of({"p1": "room-l"}))) == ["Living room · 1"]


def test_a_named_place_at_the_door_leaves_no_other_place_the_word() -> None:
    plan = plan_of({"p1": "room-l", "p2": "room-l"})
    assert names(named_by_rooms([named_place(1, 2.9, "Mat"), place(2, 2.4)], plan)) == ["Mat", "Living room · 1"]
