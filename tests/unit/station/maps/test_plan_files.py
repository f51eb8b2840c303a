"""A map's floor plan is kept with it: through versions, undo and folders; damage becomes a sentence."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shared.errors import DataError
from station.maps.folder import load_map_folder, save_map_folder
from station.maps.plan_files import CELLS, decode_plan, describe_plan, encode_plan
from station.maps.record import map_content_hash
from station.maps.store import MapStore
from station.model.floor_plan import FloorPlan, NameSuggestion, PlanEdits
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from station.places.rooms.planning import with_plan
from tests.support.places import make_map
from tests.support.plans import two_rooms, with_two_rooms
from tests.support.store import content_hash

EDITS = PlanEdits((np.array([[1.0, -1.5], [1.0, 1.5]]),), (np.array([[3.0, 0.0], [3.0, 0.5]]),), {"room-l": "Salon"})
SUGGESTION = NameSuggestion(
    "room-k",
    "Kitchen",
    "sticker",
    0.98,
    "a sticker says so",
    3,
    np.arange(8.0).reshape(4, 2),
    np.array([7.0, 1.0, 0.3]),
)


@pytest.fixture
def planned() -> PlaceMap:
    return replace(with_two_rooms(make_map()), plan_edits=EDITS, suggestions=(SUGGESTION,))


@pytest.fixture
def store(tmp_path: Path) -> MapStore:
    return MapStore(StoreAddress(tmp_path / "maps", author="desk"))


def plan_of(place_map: PlaceMap) -> FloorPlan:
    assert place_map.plan is not None
    return place_map.plan


def assert_same_plan(a: PlaceMap, b: PlaceMap) -> None:
    assert encode_plan(describe_plan(a)) == encode_plan(describe_plan(b))
    for name in ("state", "room", "walls"):
        np.testing.assert_array_equal(getattr(plan_of(a), name), getattr(plan_of(b), name))


def without_wall(place_map: PlaceMap) -> PlaceMap:
    return replace(place_map, plan=replace(plan_of(place_map), walls=plan_of(place_map).walls[1:]))


def test_a_plan_comes_back_as_it_was_saved(planned: PlaceMap, store: MapStore) -> None:
    store.save(planned)
    assert_same_plan(store.load(planned.id), planned)
    assert content_hash(store, planned.id) == map_content_hash(planned)


def test_a_map_without_a_plan_is_written_as_it_was_before_there_were_plans(store: MapStore) -> None:
    store.save(make_map())
    record = store.history("map")[0]
    assert CELLS not in record.files
    assert encode_plan(record.plan) == {}
    assert store.load("map").plan is None


def test_undo_brings_an_earlier_plan_back(planned: PlaceMap, store: MapStore) -> None:
    store.save(planned)
    changed, _ = store.edit(planned.id, without_wall, "a wall is gone")
    assert_same_plan(store.load(planned.id), changed)
    store.undo(planned.id)
    assert_same_plan(store.load(planned.id), planned)


def test_the_hash_of_a_map_covers_its_plan(planned: PlaceMap) -> None:
    other_name = replace(planned, plan_edits=replace(EDITS, names={"room-l": "Lounge"}))
    assert len({map_content_hash(one) for one in (planned, without_wall(planned), other_name, make_map())}) == 4


def test_a_map_folder_lists_rooms_and_keeps_the_plan(planned: PlaceMap, tmp_path: Path) -> None:
    save_map_folder(planned, tmp_path / "map")
    document = json.loads((tmp_path / "map" / "map.json").read_text().partition("\n")[2])
    assert [(room["id"], room["name"]) for room in document["rooms"]] == [
        ("room-l", "Living room"),
        ("room-k", "Room 2"),
    ]
    assert_same_plan(load_map_folder(tmp_path / "map"), planned)
    (tmp_path / ".new-x" / "before").mkdir(parents=True)
    (tmp_path / "map").rename(tmp_path / ".new-x" / "before" / "map")  # by a program that was killed then
    assert_same_plan(load_map_folder(tmp_path / "map"), planned)
    (tmp_path / "map" / CELLS).write_bytes(b"no plan")
    with pytest.raises(DataError, match=r"floor_plan\.npz is damaged"):
        load_map_folder(tmp_path / "map")


def test_a_map_that_replaces_one_in_a_folder_leaves_what_else_lies_there(planned: PlaceMap, tmp_path: Path) -> None:
    folder = tmp_path / "map"
    save_map_folder(planned, folder, {"graph.graphml": "old"})
    (folder / "pictures").mkdir()
    (folder / "pictures" / "mine.txt").write_text("my own")
    (folder / "link").symlink_to("pictures")
    save_map_folder(make_map(), folder, {"graph.graphml": "new"})
    assert (folder / "link" / "mine.txt").read_text() == "my own" and (folder / "link").is_symlink()
    assert (folder / "graph.graphml").read_text() == "new" and not (folder / CELLS).exists()
    assert load_map_folder(folder).plan is None


def test_a_damaged_plan_falls_back_to_the_version_before(planned: PlaceMap, tmp_path: Path) -> None:
    heard: list[str] = []
    store = MapStore(StoreAddress(tmp_path / "maps", author="desk"), heard.append)
    store.save(planned)
    store.edit(planned.id, without_wall, "a wall is gone")
    address = store.history(planned.id)[0].files[CELLS].address
    [blob] = (tmp_path / "maps" / "blobs").rglob(address)
    blob.write_bytes(b"x" * 100)
    assert_same_plan(store.load(planned.id), planned)
    assert any(CELLS in sentence and "Version 1" in sentence for sentence in heard)


def _npz(**others: Any) -> bytes:
    plan = two_rooms()
    file = io.BytesIO()
    np.savez_compressed(file, **({"state": plan.state, "room": plan.room, "walls": plan.walls} | others))
    return file.getvalue()


@pytest.mark.parametrize(
    "cells",
    [
        _npz(room=np.full((100, 50), 7, dtype=np.int16)),
        _npz(state=np.zeros((3, 3), dtype=np.uint8)),
        _npz(walls=np.full((1, 2, 2), np.nan)),
        _npz(state=np.zeros((3000, 3000), dtype=np.uint8)),
        b"PK",
    ],
    ids=["a room that is not there", "other cells", "no number", "too large", "no file"],
)
def test_cells_that_do_not_fit_are_refused(planned: PlaceMap, store: MapStore, cells: bytes) -> None:
    store.save(planned)
    contents = store.for_writing()
    record = store.history(planned.id)[0]
    contents.save_record(replace(record, files={**record.files, **contents.put({CELLS: cells})}))
    heard = store.load(planned.id)  # the version before is used
    assert_same_plan(heard, planned)
    with pytest.raises(DataError, match="is no floor plan"):
        store.load(planned.id, 2)


@pytest.mark.parametrize(
    "harm",
    [
        lambda content: content["rooms"].pop(),
        lambda content: content["rooms"][0].update(middle=[1.0, "x"]),
        lambda content: content["floor_plan"].update(cell=0.0),
        lambda content: content["floor_plan"].update(low=[0.0]),
        lambda content: content["floor_plan"]["edits"].update(doors_drawn=[[[0.0, float("inf")], [1.0, 1.0]]]),
        lambda content: content["floor_plan"]["suggestions"][0].update(source="a guess"),
        lambda content: content["floor_plan"].update(R_ground_map=[[0.0] * 3] * 3),
        lambda content: content["floor_plan"].update(R_ground_map=np.diag([1.0, 1.0, -1.0]).tolist()),
        lambda content: content["rooms"][0].update(area=-1.0),
        lambda content: content["floor_plan"]["suggestions"][0].update(confidence=50.0),
        lambda content: content["floor_plan"]["suggestions"][0].update(keyframe_index=-7),
        lambda content: content["floor_plan"]["doors"][1].update(id=content["floor_plan"]["doors"][0]["id"]),
        lambda content: content["rooms"][1].update(name="living ROOM"),
        lambda content: content["rooms"][0].update(name=""),
        lambda content: content["rooms"][0].update(name="x" * 10**6),
        lambda content: content["floor_plan"]["edits"].update(names={"room-l": "x" * 81}),
        lambda content: content["floor_plan"]["suggestions"][0].update(name="x" * 81),
        lambda content: content["floor_plan"]["suggestions"][0].update(p_map=[0.0, 1.0]),
        lambda content: content["floor_plan"]["edits"].update(doors_drawn=[[[0.0, 0.0], [1.0, 1.0]]] * 100_000),
    ],
)
def test_a_record_whose_plan_cannot_be_is_refused(planned: PlaceMap, harm: Callable[[dict[str, Any]], Any]) -> None:
    content = json.loads(json.dumps(encode_plan(describe_plan(planned))))
    harm(content)
    with pytest.raises(ValueError):  # noqa: PT011
        decode_plan(content)


def test_a_suggestion_of_a_picture_that_there_is_not_is_refused(planned: PlaceMap, store: MapStore) -> None:
    pictures = len(planned.navigation.keyframes.encoded)
    store.save(replace(planned, suggestions=(replace(SUGGESTION, keyframe_index=pictures),)))
    with pytest.raises(DataError, match="is no floor plan"):
        store.load(planned.id)


def test_a_plan_that_was_made_has_no_name_and_no_door_twice(planned: PlaceMap, store: MapStore) -> None:
    plan = plan_of(planned)
    rooms = tuple(replace(room, name=name) for room, name in zip(plan.rooms, ("Kitchen", "kitchen"), strict=True))
    doors = tuple(replace(door, id="door-a") for door in plan.doors)
    made = with_plan(planned, replace(plan, rooms=rooms, doors=doors))
    assert [room.name for room in plan_of(made).rooms] == ["Kitchen", "Room 1"]
    assert [door.id for door in plan_of(made).doors] == ["door-a", "door-1"]
    store.save(made)
    assert_same_plan(store.load(made.id), made)
