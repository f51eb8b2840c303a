"""A map built again keeps what people did to its rooms, also while it was built, and all of that can be undone."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from station.files.navigation_folder import save_navigation
from station.library.place_changes import changes_of
from station.maps.editing import with_place_renamed
from station.maps.record import describe_map, encode_record
from station.maps.repair.check import verify
from station.maps.store import MapStore
from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from station.places.making.changes import with_places_merged
from station.places.rooms.edits import require_plan, with_room_renamed
from station.places.rooms.planning import planned, with_suggestions_of
from station.workers import library_jobs
from station.workers.library_jobs import LibraryJobs
from tests.support.coloured_rooms import GREY, coloured_rooms
from tests.support.made_up_workers import made_up_navigation
from tests.support.store import leave_old_blob


def build(folder: Path) -> str:
    made = LibraryJobs(lambda _: None).build_map([folder / "drive"], StoreAddress(folder / "maps"), "Home", None)
    return made.map_id


def room_names(place_map: PlaceMap) -> list[str]:
    return [room.name for room in require_plan(place_map).rooms]


def said_changes(store: MapStore, map_id: str) -> list[str]:
    return [change.why for change in changes_of(store.history(map_id))]


@pytest.mark.computing
def test_a_build_removes_what_one_left_that_was_killed(tmp_path: Path) -> None:
    save_navigation(made_up_navigation(), tmp_path / "drive")
    left = leave_old_blob(tmp_path / "maps")
    build(tmp_path)
    assert not left.exists() and verify(MapStore(tmp_path / "maps")) == ()


@pytest.mark.computing
def test_what_people_do_while_a_map_is_built_again_stays_and_can_be_undone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_navigation(made_up_navigation(), tmp_path / "drive")
    map_id = build(tmp_path)
    store = MapStore(tmp_path / "maps")
    first = store.load(map_id)
    room, place = require_plan(first).rooms[0].id, first.places[0].id
    store.edit(map_id, partial(with_place_renamed, place_id=place, name="Sofa"), "the sofa is named")

    def look_while_a_person_names_the_room(place_map: PlaceMap, plan: FloorPlan) -> tuple[NameSuggestion, ...]:
        store.edit(map_id, partial(with_room_renamed, room_id=room, name="Kitchen"), "the kitchen is named")
        return ()

    monkeypatch.setattr(library_jobs, "sticker_names", look_while_a_person_names_the_room)
    assert build(tmp_path) == map_id
    built = store.load(map_id)
    assert room_names(built)[0] == "Kitchen" and built.plan_edits.names == {room: "Kitchen"}
    assert built.places[0].name == "Sofa" and "Kitchen · 2" in [place.name for place in built.places]
    assert said_changes(store, map_id) == ["the kitchen is named", "the sofa is named"]


@pytest.mark.computing
def test_a_first_map_is_planned_once_as_if_with_what_its_pictures_suggest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_navigation(made_up_navigation(), tmp_path / "drive")
    drafts: list[PlaceMap] = []
    found: list[NameSuggestion] = []

    def planned_once(place_map: PlaceMap, earlier: PlaceMap | None) -> PlaceMap:
        drafts.append(place_map)
        return planned(place_map, earlier)

    def names(place_map: PlaceMap, plan: FloorPlan) -> tuple[NameSuggestion, ...]:
        corners, p_map = np.zeros((4, 2)), place_map.places[0].centroid_map
        found.append(NameSuggestion(plan.rooms[0].id, "Kitchen", "sticker", 0.9, "A sticker.", 0, corners, p_map))
        return tuple(found)

    monkeypatch.setattr(library_jobs, "planned", planned_once)
    monkeypatch.setattr(library_jobs, "sticker_names", names)
    made = MapStore(tmp_path / "maps").load(build(tmp_path))
    [draft] = drafts
    expected = planned(replace(draft, suggestions=tuple(found)))
    assert [s.name for s in made.suggestions] == ["Kitchen"]
    assert encode_record(describe_map(made, {})) == encode_record(describe_map(expected, {}))


@pytest.mark.computing
def test_other_maps_are_asked_until_one_knows_a_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_navigation(made_up_navigation(), tmp_path / "drive")
    store, asked = MapStore(tmp_path / "maps"), []
    for number in range(5):
        flat = coloured_rooms([[GREY]], [[GREY]])
        flat = replace(flat, id=f"map-{number}", navigation=replace(flat.navigation, id=f"nav-{number}"))
        store.save(with_room_renamed(flat, "room-k", "Kitchen"))

    def names_in(other: PlaceMap, place_map: PlaceMap, _: object) -> tuple[NameSuggestion, ...]:
        asked.append(other.id)
        room = require_plan(place_map).rooms[0].id
        return (NameSuggestion(room, "Kitchen", "other map", 0.5, ""),) if len(asked) % 5 == 2 else ()

    monkeypatch.setattr(library_jobs, "names_in", names_in)
    monkeypatch.setattr(library_jobs, "sticker_names", lambda place_map, plan: ())
    made = store.load(build(tmp_path))
    assert len(asked) == 2 and [s.name for s in made.suggestions] == ["Kitchen"]
    assert store.load(build(tmp_path)).suggestions == () and len(asked) == 5


@pytest.mark.computing
def test_names_read_from_plates_stay_while_the_same_map_is_built_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_navigation(made_up_navigation(), tmp_path / "drive")
    map_id = build(tmp_path)
    store = MapStore(tmp_path / "maps")
    read = NameSuggestion(require_plan(store.load(map_id)).rooms[0].id, "Pantry", "door plate", 0.7, "A plate.")
    store.edit(map_id, partial(with_suggestions_of, source="door plate", found=[read]), "plates were read")
    assert said_changes(store, map_id) == []  # nobody can take back what nobody did
    assert build(tmp_path) == map_id
    assert [s.name for s in store.load(map_id).suggestions] == ["Pantry"]
    monkeypatch.setattr(library_jobs, "plate_names", lambda *_: ())  # as a reader that failed
    assert not LibraryJobs(lambda _: None).read_plates(StoreAddress(tmp_path / "maps"), map_id)
    assert [s.name for s in store.load(map_id).suggestions] == ["Pantry"]


@pytest.mark.computing
def test_building_again_is_one_more_change_where_it_makes_other_places(tmp_path: Path) -> None:
    save_navigation(made_up_navigation(), tmp_path / "drive")
    map_id = build(tmp_path)
    store = MapStore(tmp_path / "maps")
    two = [place.id for place in store.load(map_id).places[:2]]
    merged, _ = store.edit(map_id, partial(with_places_merged, place_ids=two), "two places are one")
    build(tmp_path)
    assert len(store.load(map_id).places) == len(merged.places) + 1
    assert len(said_changes(store, map_id)) == 2
    store.undo(map_id)
    assert len(store.load(map_id).places) == len(merged.places)
