"""A sticker names the room on whose side it hangs, or none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import zxingcpp

from station.model.floor_plan import NO_ROOM, FloorPlan, NameSuggestion, Room
from station.model.place_map import PlaceMap
from station.places.naming.suggest import suggest_names
from station.places.rooms.planning import with_plan, with_suggestions
from tests.support.plans import WALL_X, two_rooms
from tests.support.stickers import code_picture, looking_along_x, map_of_pictures, sticker_picture


def suggested(name: str, at: list[tuple[float, float]], distance_m: float = 1.5) -> tuple[NameSuggestion, ...]:
    pictures = [sticker_picture(name, distance_m)] * len(at)
    return suggest_names(map_of_pictures(pictures, [looking_along_x(*xy) for xy in at]), two_rooms())


def test_a_sticker_seen_once_names_its_room_and_shows_where() -> None:
    (found,) = suggested("Kitchen", [(5.4, 1.0)])
    assert (found.room, found.name, found.source, found.keyframe_index) == ("room-k", "Kitchen", "sticker", 0)
    assert "1.5 m" in found.reason and found.confidence > 0.9
    assert found.corners_px is not None
    np.testing.assert_allclose(found.corners_px.mean(axis=0), [319.5, 239.5], atol=1.0)
    assert found.p_map is not None
    np.testing.assert_allclose(found.p_map, [6.9, 1.0, 0.3], atol=0.1)


def test_a_sticker_is_no_surer_of_a_room_than_the_plan_is() -> None:
    plan = two_rooms()
    doubtful = replace(plan, rooms=tuple(replace(room, certainty=0.6) for room in plan.rooms))
    pictures = map_of_pictures([sticker_picture("Kitchen", 1.5)], [looking_along_x(5.4, 1.0)])
    (sure,), (found,) = suggest_names(pictures, plan), suggest_names(pictures, doubtful)
    assert found.confidence == pytest.approx(0.6 * sure.confidence)


def test_a_sticker_on_the_near_side_of_a_wall_names_this_room() -> None:
    (found,) = suggested("Parlour", [(WALL_X - 1.5, 1.2)])
    assert found.room == "room-l"


def test_a_sticker_seen_through_a_door_names_the_room_behind_it() -> None:
    (found,) = suggested("Kitchen", [(WALL_X - 0.5, 0.0)], distance_m=1.6)
    assert found.room == "room-k"


def test_a_sticker_whose_distance_leaves_the_room_open_names_none() -> None:
    assert suggested("Kitchen", [(WALL_X - 1.25, 0.0)]) == ()  # a quarter of a metre behind an open door


def test_two_stickers_that_read_alike_name_a_room_each() -> None:
    assert {s.room for s in suggested("Bedroom", [(1.4, 1.2), (5.4, 1.0)])} == {"room-l", "room-k"}


def test_several_pictures_of_one_sticker_are_one_suggestion() -> None:
    (found,) = suggested("Kitchen", [(5.4, 1.0), (5.4, 1.1), (5.4, 0.9)])
    assert "3 pictures" in found.reason


def test_a_room_that_has_the_name_already_gets_no_suggestion() -> None:
    assert suggested("Living room", [(1.4, 1.2)]) == ()


@pytest.mark.parametrize("text", ["WIFI:S:home;T:WPA;P:secret;;", "https://example.org/kitchen", "4006381333931"])
def test_codes_about_something_else_name_nothing(text: str) -> None:
    code = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.QRCode, ec_level="L")
    picture = code_picture(np.array(code.to_image(scale=1, add_quiet_zones=False)) == 0, 1.0)
    assert suggest_names(map_of_pictures([picture], [looking_along_x(5.4, 1.0)]), two_rooms()) == ()


def test_a_damaged_picture_is_passed_over() -> None:
    pictures = [b"no picture", sticker_picture("Kitchen", 1.5)]
    found = suggest_names(map_of_pictures(pictures, [looking_along_x(5.4, 1.0)] * 2), two_rooms())
    assert [s.keyframe_index for s in found] == [1]


def test_a_map_without_a_plan_gets_no_suggestions() -> None:
    place_map: PlaceMap = map_of_pictures([sticker_picture("Kitchen", 1.5)], [looking_along_x(5.4, 1.0)])
    assert with_suggestions(place_map).suggestions == ()


def flat_with_stickers(*stickers: tuple[str, tuple[float, float]]) -> PlaceMap:
    """Of two rooms, with names that stickers suggest, each seen from where it says."""
    pictures = [sticker_picture(name, 1.5) for name, _ in stickers]
    seen = map_of_pictures(pictures, [looking_along_x(*xy) for _, xy in stickers])
    return with_suggestions(replace(seen, plan=two_rooms()))


def of_one_room(plan: FloorPlan) -> FloorPlan:
    """As after merging: the first room, over both."""
    merged = np.where(plan.room == NO_ROOM, NO_ROOM, 0).astype(np.int16)
    return replace(plan, room=merged, rooms=plan.rooms[:1], doors=())


def test_merged_rooms_have_the_names_of_both_stickers_and_neither_is_sure() -> None:
    flat = flat_with_stickers(("Parlour", (WALL_X - 1.5, 1.2)), ("Kitchen", (5.4, 1.0)))
    merged = with_plan(flat, of_one_room(two_rooms()))
    assert [(s.room, s.name) for s in merged.suggestions] == [("room-l", "Kitchen"), ("room-l", "Parlour")]
    assert [s.confidence for s in merged.suggestions] == pytest.approx([0.495, 0.495])


def test_where_both_stickers_of_merged_rooms_read_alike_the_name_is_as_sure_as_before() -> None:
    flat = flat_with_stickers(("Bedroom", (WALL_X - 1.5, 1.2)), ("Bedroom", (5.4, 1.0)))
    [found] = with_plan(flat, of_one_room(two_rooms())).suggestions
    assert found.confidence == pytest.approx(0.99)


def test_the_part_of_a_room_that_was_split_in_which_the_sticker_hangs_gets_its_name() -> None:
    plan = two_rooms()
    joined = with_plan(flat_with_stickers(("Kitchen", (5.4, 1.0))), of_one_room(plan))
    parted = replace(plan, rooms=(plan.rooms[0], Room("room-new", "Room 3", 12.0, plan.rooms[1].middle, 0.5)))
    [found] = with_plan(joined, parted).suggestions
    assert (found.room, found.name) == ("room-new", "Kitchen")
    assert found.confidence == pytest.approx(0.5 * 0.99)


def test_a_suggestion_of_before_positions_were_noted_stays_with_its_room_while_it_is_there() -> None:
    flat = flat_with_stickers(("Kitchen", (5.4, 1.0)))
    older = replace(flat, suggestions=tuple(replace(s, p_map=None) for s in flat.suggestions))
    assert with_plan(older, two_rooms()).suggestions[0].room == "room-k"
    assert with_plan(older, of_one_room(two_rooms())).suggestions == ()


def test_a_plan_made_again_hands_on_the_same_suggestions() -> None:
    flat = flat_with_stickers(("Parlour", (WALL_X - 1.5, 1.2)), ("Kitchen", (5.4, 1.0)))
    again = with_plan(flat, two_rooms())
    assert {(s.room, s.name, s.confidence) for s in again.suggestions} == {
        (s.room, s.name, s.confidence) for s in flat.suggestions
    }
