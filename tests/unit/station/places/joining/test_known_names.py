"""How much of a room another map must have, and how surely, before it is suggested its name there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import se3
from station.model.floor_plan import NO_ROOM, FloorPlan, NameSuggestion, PlanEdits
from station.model.place_map import PlaceMap
from station.places.joining import known_names
from station.places.joining.known_names import names_in
from station.places.making.config import PlacesConfig
from station.places.registration.result import refused
from tests.support.plans import two_rooms
from tests.support.stickers import looking_along_x, map_of_pictures

CONFIDENCE = 0.9


def flat(plan: FloorPlan, **names: str) -> PlaceMap:
    """With a picture in each room, and with rooms (room_l, room_k) named by a person."""
    edits = PlanEdits(names={id.replace("_", "-"): name for id, name in names.items()})
    rooms = tuple(replace(room, name=edits.names.get(room.id, room.name)) for room in plan.rooms)
    pictures = map_of_pictures([b"", b""], [looking_along_x(1.0, 0.0), looking_along_x(5.0, 0.0)])
    return replace(pictures, name="Monday", plan=replace(plan, rooms=rooms), plan_edits=edits)


def suggested(
    monkeypatch: pytest.MonkeyPatch, other: PlaceMap, place_map: PlaceMap, shift_m: float = 0.0
) -> tuple[NameSuggestion, ...]:
    """The other map lies that far along x in the new one."""
    T_other_map = se3(np.eye(3), np.array([-shift_m, 0.0, 0.0]))
    found = replace(refused("", "made up"), accepted=True, T_target_source=T_other_map, confidence=CONFIDENCE)
    monkeypatch.setattr(known_names, "align_navigation", lambda *_: found)
    return names_in(other, place_map, PlacesConfig())


def test_what_the_other_map_never_saw_says_nothing_against_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other drive turned in the kitchen's first half; the plans are sure, so the registration alone is not."""
    plan = two_rooms()
    half = plan.room.copy()
    half[66:] = NO_ROOM
    kitchen = int((plan.room == 1).sum())
    (found,) = suggested(monkeypatch, flat(replace(plan, room=half), room_k="Kitchen"), flat(plan))
    assert (found.room, found.name, found.keyframe_index) == ("room-k", "Kitchen", 1)
    assert found.confidence == pytest.approx(CONFIDENCE)
    covered = (half == 1).sum() / kitchen
    assert found.reason == f'Of this room {covered:.0%} is in the map "Monday", and 100% of that is Kitchen there.'


def test_a_room_that_is_two_there_is_as_likely_called_as_the_larger_part(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = two_rooms()
    parted = plan.room.copy()
    parted[71:85] = np.where(parted[71:85] == 1, 0, NO_ROOM)
    share = (parted[45:] == 1).sum() / (plan.room == 1).sum()
    (found,) = suggested(monkeypatch, flat(replace(plan, room=parted), room_k="Kitchen"), flat(plan))
    assert found.confidence == pytest.approx(CONFIDENCE * share)


def test_rooms_that_only_touch_are_not_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other map's hall ends 0.2 m behind the wall of this one's living room."""
    assert suggested(monkeypatch, flat(two_rooms(), room_k="Hall"), flat(two_rooms()), shift_m=-7.8) == ()
    assert len(suggested(monkeypatch, flat(two_rooms(), room_k="Hall"), flat(two_rooms()))) == 1
