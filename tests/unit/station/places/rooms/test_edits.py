"""What people make of rooms holds in the plan made anew: names, doors drawn and erased, rooms that are one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from shared.errors import DataError
from station.model.floor_plan import NO_ROOM, FloorPlan
from station.model.place_map import PlaceMap
from station.places.rooms import edits as edits_module
from station.places.rooms.edits import (
    require_plan,
    room_id_at,
    with_door_erased,
    with_name_taken_back,
    with_room_renamed,
    with_room_split,
    with_rooms_merged,
)
from station.places.rooms.planning import planned
from tests.support.places import make_map
from tests.support.plans import with_two_rooms
from tests.support.rooms import room_with_a_door


@pytest.fixture(scope="module")
def one_room() -> PlaceMap:
    """A plan as it is made of a navigation."""
    made = planned(room_with_a_door())
    assert len(require_plan(made).rooms) == 1
    return made


def across(plan: FloorPlan) -> np.ndarray:
    """A line through the middle of the first room, longer than it."""
    x, y = plan.rooms[0].middle
    return np.array([[x, y - 6.0], [x, y + 6.0]])


def test_a_name_is_kept_when_the_plan_is_made_anew(one_room: PlaceMap) -> None:
    room = require_plan(one_room).rooms[0]
    named = with_room_renamed(one_room, room.id, "Kitchen")
    assert [r.name for r in require_plan(named).rooms] == ["Kitchen"]
    assert [(r.id, r.name) for r in require_plan(planned(named)).rooms] == [(room.id, "Kitchen")]


@pytest.mark.parametrize("name", ["LIVING room", "Living\u200d room"])
def test_names_are_unique_whatever_their_letters(name: str) -> None:
    with pytest.raises(DataError, match="another room named"):
        with_room_renamed(with_two_rooms(make_map()), "room-k", name)


def test_a_door_that_was_drawn_parts_the_room_and_erased_it_is_one_again(one_room: PlaceMap) -> None:
    room = require_plan(one_room).rooms[0]
    parted = with_room_split(with_room_renamed(one_room, room.id, "Salon"), across(require_plan(one_room)))
    plan = require_plan(parted)
    assert len(plan.rooms) == 2 and [r.name for r in plan.rooms if r.id == room.id] == ["Salon"]
    [door] = [door for door in plan.doors if door.is_drawn]
    whole = with_door_erased(parted, door.id)
    assert [(r.id, r.name) for r in require_plan(whole).rooms] == [(room.id, "Salon")]
    assert whole.plan_edits.doors_drawn == ()


def test_merged_rooms_keep_id_and_name_of_the_first(one_room: PlaceMap) -> None:
    parted = with_room_split(one_room, across(require_plan(one_room)))
    for wanted in require_plan(parted).rooms:
        others = [room.id for room in require_plan(parted).rooms if room.id != wanted.id]
        [merged] = require_plan(with_rooms_merged(parted, [wanted.id, *others])).rooms
        assert (merged.id, merged.name) == (wanted.id, wanted.name)


def test_a_line_that_parts_nothing_is_refused(one_room: PlaceMap) -> None:
    beside = require_plan(one_room).rooms[0].middle + 50.0
    with pytest.raises(DataError, match="parts no room"):
        with_room_split(one_room, np.array([beside, beside + 1.0]))
    with pytest.raises(DataError, match="too short"):
        with_room_split(one_room, np.array([beside, beside]))


def test_a_name_that_is_taken_back_leaves_a_number_that_no_room_has() -> None:
    flat = with_two_rooms(make_map())
    assert with_name_taken_back(flat, "room-k") is flat
    for other, own in (("Living room", "Room 2"), ("Room 2", "Room 1")):
        named = with_room_renamed(with_room_renamed(flat, "room-k", "Kitchen"), "room-l", other)
        cleared = with_name_taken_back(named, "room-k")
        assert [room.name for room in require_plan(cleared).rooms] == [other, own]
        assert cleared.plan_edits.names == {"room-l": other}


def test_a_name_stays_with_its_half_when_rooms_are_made_one_and_parted_again(one_room: PlaceMap) -> None:
    x, y = require_plan(one_room).rooms[0].middle
    off_middle = np.array([[x - 0.6, y - 6.0], [x - 0.6, y + 6.0]])
    parted = with_room_split(one_room, off_middle)
    smaller, larger = sorted(require_plan(parted).rooms, key=lambda room: room.area)
    named = with_room_renamed(parted, smaller.id, "Pantry")
    whole = with_rooms_merged(named, [smaller.id, larger.id])
    again = with_room_split(planned(whole), off_middle)
    assert sorted((r.area, r.name == "Pantry") for r in require_plan(again).rooms) == [
        (smaller.area, True),
        (larger.area, False),
    ]


def test_a_door_that_is_erased_takes_no_name_from_a_room(one_room: PlaceMap) -> None:
    parted = with_room_split(one_room, across(require_plan(one_room)))
    [door] = [door for door in require_plan(parted).doors if door.is_drawn]
    for room_id in (room.id for room in require_plan(parted).rooms):
        whole = with_door_erased(with_room_renamed(parted, room_id, "Pantry"), door.id)
        assert [(r.id, r.name) for r in require_plan(whole).rooms] == [(room_id, "Pantry")]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ([[30.0, 0.0], [30.0, 4.0]], "outside of all"),
        ([[-3.0, 2.0], [2.0, 2.0]], "ends inside of Room 1"),
        ([[1.0, 2.0], [2.0, 2.0]], "ends inside of Room 1"),
        ([[-0.02, -1.0], [-0.02, 5.0]], "parts no room"),  # along a wall
    ],
)
def test_a_line_that_parts_no_room_is_refused_before_a_plan_is_made(
    one_room: PlaceMap, monkeypatch: pytest.MonkeyPatch, line: list[list[float]], words: str
) -> None:
    def none_is_made(_: PlaceMap) -> PlaceMap:
        raise AssertionError("a plan was made of a line that parts no room")

    monkeypatch.setattr(edits_module, "planned", none_is_made)
    R = require_plan(one_room).R_ground_map[:2, :2]
    with pytest.raises(DataError, match=words):
        with_room_split(one_room, np.array(line) @ R.T)


@pytest.mark.parametrize("shift_m", [0.0, 0.1, 0.3])
def test_a_door_is_not_drawn_twice(one_room: PlaceMap, shift_m: float) -> None:
    """A hand does not meet the first line: what lies between both would be a room that nobody can be in."""
    line = across(require_plan(one_room))
    parted = with_room_split(one_room, line)
    with pytest.raises(DataError, match="there is a door already, between Room 1 and Room 2"):
        with_room_split(parted, line[::-1] + np.array([shift_m, 0.0]))
    assert len(require_plan(with_room_split(parted, line + np.array([1.0, 0.0]))).rooms) == 3


def test_a_strip_as_thin_as_a_wall_is_no_room(one_room: PlaceMap) -> None:
    plan = require_plan(one_room)
    x = plan.low[0] + plan.cell * np.flatnonzero((plan.room != NO_ROOM).any(axis=1)).min() + 0.2 * plan.unit
    with pytest.raises(DataError, match="parts no room"):
        with_room_split(one_room, np.array([[x, -9.0], [x, 9.0]]))


def test_a_door_is_not_erased_twice(one_room: PlaceMap) -> None:
    parted = with_room_split(one_room, across(require_plan(one_room)))
    [door] = [door for door in require_plan(parted).doors if door.is_drawn]
    with pytest.raises(DataError, match="has no door with id"):
        with_door_erased(with_door_erased(parted, door.id), door.id)


def test_a_door_is_drawn_in_a_plan_that_had_more_rooms_than_it_has_when_made_anew(one_room: PlaceMap) -> None:
    plan = require_plan(one_room)
    gone = replace(plan.rooms[0], id="room-gone", name="Gone")
    older = replace(one_room, plan=replace(plan, rooms=(*plan.rooms, gone)))
    assert len(require_plan(with_room_split(older, across(plan))).rooms) == 2


def test_what_there_is_not_is_refused_by_name() -> None:
    flat = with_two_rooms(make_map())
    cases: list[tuple[Callable[[], PlaceMap], str]] = [
        (lambda: with_room_renamed(flat, "room-x", "Hall"), 'no room with id "room-x"'),
        (lambda: with_door_erased(flat, "door-x"), 'no door with id "door-x"'),
        (lambda: with_rooms_merged(flat, ["room-l", "room-l"]), "two different rooms"),
        (lambda: with_room_renamed(make_map(), "room-l", "Hall"), "has no floor plan"),
    ]
    for change, words in cases:
        with pytest.raises(DataError, match=words):
            change()


def test_edits_are_bounded(one_room: PlaceMap, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edits_module, "MAX_EDITS", 0)
    with pytest.raises(DataError, match="at most 0 doors"):
        with_room_split(one_room, across(require_plan(one_room)))


def test_a_position_is_in_the_room_that_the_plan_says() -> None:
    plan = require_plan(with_two_rooms(make_map()))
    turned = replace(plan, R_ground_map=np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert room_id_at(turned, np.array([5.0, 0.0])) == "room-k"
    assert room_id_at(turned, np.array([50.0, 0.0])) is None
