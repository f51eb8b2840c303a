"""Maps come back as they were saved, with their history; damage becomes a sentence, never a traceback or half a map."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shared.errors import ConfigError, DataError
from shared.text import is_printable
from station.maps import bucket as bucket_module
from station.maps import store as store_module
from station.maps.folder import save_map_folder
from station.maps.record import (
    decode_places,
    decode_record,
    describe_map,
    encode_place,
    encode_record,
    map_content_hash,
)
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from station.places.making.build import carry_names
from tests.support.depth import depth_camera, map_of, scanned, way
from tests.support.store import content_hash, rename_place


def holds(store: MapStore, place_map: PlaceMap) -> bool:
    return content_hash(store, place_map.id) == map_content_hash(place_map)


def renamed(place_map: PlaceMap, name: str) -> PlaceMap:
    return replace(place_map, name=name)


def test_a_map_comes_back_as_it_was_saved(place_map: PlaceMap, address: StoreAddress) -> None:
    MapStore(address).save(place_map)
    again = MapStore(address).load(place_map.id)
    assert (again.id, again.name, again.edges, again.config) == (
        place_map.id, place_map.name, place_map.edges, place_map.config
    )  # fmt: skip
    assert again.navigation.id == place_map.navigation.id
    for a, b in zip(again.places, place_map.places, strict=True):
        assert (a.id, a.name, a.radius, a.quality, a.representative_keyframe) == (
            b.id, b.name, b.radius, b.quality, b.representative_keyframe
        )  # fmt: skip
        np.testing.assert_array_equal(a.centroid_map, b.centroid_map)
        np.testing.assert_array_equal(a.landmark_index, b.landmark_index)
        np.testing.assert_array_equal(a.keyframe_index, b.keyframe_index)
    np.testing.assert_array_equal(again.navigation.landmarks.p_world, place_map.navigation.landmarks.p_world)
    assert again.navigation.keyframes.encoded == place_map.navigation.keyframes.encoded
    assert holds(MapStore(address), place_map)


def test_depth_comes_back_with_its_map(place_map: PlaceMap, address: StoreAddress) -> None:
    T, sensor = way(10), depth_camera(32, 24)
    depth = scanned(map_of(T), sensor, T).depth
    assert depth is not None
    MapStore(address).save(replace(place_map, navigation=replace(place_map.navigation, depth=depth)))
    again = MapStore(address).load(place_map.id).navigation.depth
    assert again is not None and again.sensor == depth.sensor
    np.testing.assert_array_equal(again.millimetres, depth.millimetres)
    MapStore(address).save(place_map)
    assert MapStore(address).load(place_map.id).navigation.depth is None


UNPRINTABLE = ["Sofa\x00", "\x1b[2Jcorner", "Sofa \u202eroom"]


@pytest.mark.parametrize("name", UNPRINTABLE)
def test_names_that_cannot_be_shown_are_refused_in_every_database(
    place_map: PlaceMap, address: StoreAddress, name: str
) -> None:
    store = MapStore(address)
    with pytest.raises(DataError, match="cannot be shown"):
        store.save(renamed(place_map, name))
    store.save(place_map)
    with pytest.raises(DataError, match="cannot be shown"):
        rename_place(store, place_map.id, place_map.places[0].id, name)
    assert holds(MapStore(address), place_map)


@pytest.mark.parametrize("name", UNPRINTABLE)
def test_names_of_a_record_that_cannot_be_shown_lose_what_a_terminal_obeys(place_map: PlaceMap, name: str) -> None:
    record = json.loads(encode_record(describe_map(place_map, {}))) | {"number": 1}
    for forged in ({"name": name}, {"why": name}, {"places": [record["places"][0] | {"name": name}]}):
        read = decode_record(json.dumps(record | forged).encode(), "a backup's record")
        assert all(is_printable(text) for text in (read.name, read.why, *(place.name for place in read.places)))


def test_a_question_that_a_database_cannot_hold_damages_nothing(place_map: PlaceMap, address: StoreAddress) -> None:
    store = MapStore(address)
    store.save(place_map)
    with pytest.raises(DataError) as refused:
        store.load("map\x00")
    assert "damaged" not in str(refused.value)
    assert holds(store, place_map)


def test_a_new_name_is_kept_and_names_stay_unique(place_map: PlaceMap, address: StoreAddress) -> None:
    store = MapStore(address)
    store.save(place_map)
    first, second = place_map.places[:2]
    rename_place(store, place_map.id, first.id, "  Sofa   corner ")
    assert store.load(place_map.id).places[0].name == "Sofa corner"
    with pytest.raises(DataError, match='another place named "sofa corner"'):
        rename_place(store, place_map.id, second.id, "sofa corner")
    with pytest.raises(DataError, match="another place named"):
        rename_place(store, place_map.id, second.id, "Sofa\u200c corner")
    with pytest.raises(DataError, match="1 to 80 characters"):
        rename_place(store, place_map.id, second.id, " ")
    with pytest.raises(DataError, match='no place with id "x"'):
        rename_place(store, place_map.id, "x", "Desk")
    assert [record.why for record in store.history(place_map.id)] == [f"{first.id} is now Sofa   corner", "saved"]


def test_saving_the_same_again_changes_nothing_and_another_one_is_a_version(
    place_map: PlaceMap, address: StoreAddress
) -> None:
    store = MapStore(address)
    store.save(place_map)
    store.save(place_map)
    assert len(store.history(place_map.id)) == 1
    store.save(renamed(place_map, "Flat"))
    assert [(s.id, s.name, s.places) for s in store.list()] == [(place_map.id, "Flat", len(place_map.places))]
    assert store.load(place_map.id, 1).name == place_map.name
    with pytest.raises(DataError, match="no version 7"):
        store.load(place_map.id, 7)


def test_a_deleted_map_is_gone_until_it_is_undone(place_map: PlaceMap, address: StoreAddress) -> None:
    store = MapStore(address)
    store.save(place_map)
    store.delete(place_map.id)
    assert store.list() == () and [s.id for s in store.deleted()] == [place_map.id]
    for forbidden in (store.load, store.delete):
        with pytest.raises(DataError, match="its maps: none"):
            forbidden(place_map.id)
    store.undo(place_map.id)
    assert holds(store, place_map) and store.deleted() == ()


def test_undo_goes_back_step_by_step_and_forth_by_number(place_map: PlaceMap, address: StoreAddress) -> None:
    store = MapStore(address)
    store.save(place_map)
    place = place_map.places[0]

    def name() -> str:
        return store.load(place_map.id).places[0].name

    for new in ("Sofa", "Couch", "Settee"):
        rename_place(store, place_map.id, place.id, new)
    seen = []
    for _ in range(3):
        store.undo(place_map.id)
        seen.append(name())
    assert seen == ["Couch", "Sofa", place.name]
    with pytest.raises(DataError, match="no earlier version"):
        store.undo(place_map.id)
    store.undo(place_map.id, to=3)
    assert name() == "Couch"
    rename_place(store, place_map.id, place.id, "Bench")
    store.undo(place_map.id)
    assert name() == "Couch"
    with pytest.raises(DataError, match="no version 99"):
        store.undo(place_map.id, to=99)
    assert len({record.number for record in store.history(place_map.id)}) == 10


def test_names_survive_building_the_map_again(place_map: PlaceMap, address: StoreAddress) -> None:
    store = MapStore(address)
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, "Sofa")
    earlier = store.newest_of_navigation("nav-1")
    assert earlier is not None and store.newest_of_navigation("nav") is None
    store.save(carry_names(earlier, renamed(place_map, "built again")))
    assert store.load(place_map.id).places[0].name == "Sofa"
    store.delete(place_map.id)
    assert store.newest_of_navigation("nav-1") is None


def test_a_failed_save_leaves_what_was_there(
    place_map: PlaceMap, address: StoreAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = MapStore(address)
    store.save(place_map)

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    for target, method in ((bucket_module, "replace_files"), (store_module.versions, "add")):
        with monkeypatch.context() as patch:
            patch.setattr(target, method, fail)
            with pytest.raises(DataError, match="No space left"):
                store.save(renamed(place_map, "x"))
            with pytest.raises(DataError, match="No space left"):
                rename_place(store, place_map.id, place_map.places[0].id, "Sofa")
        assert holds(MapStore(address), place_map)


def test_a_folder_is_flushed_once_for_all_files_that_are_put_into_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[str, int]] = []  # what was flushed, and how many files had their names then

    def flush(descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        named = sum(1 for file in (tmp_path / "a").glob("[0-9]"))
        seen.append((path.name if path.is_dir() else "file", named))

    (tmp_path / "a").mkdir()
    monkeypatch.setattr(os, "fsync", flush)
    bucket_module.FolderBucket(tmp_path).put({f"a/{number}": b"x" for number in range(4)})
    assert seen == [*(("file", number) for number in range(4)), ("a", 4)]


def test_every_version_names_the_station_that_wrote_it(place_map: PlaceMap, address: StoreAddress) -> None:
    MapStore(address).save(place_map)
    other = MapStore(replace(address, author="hall"))
    rename_place(other, place_map.id, place_map.places[0].id, "Sofa")
    assert [record.author for record in other.history(place_map.id)] == ["hall", "desk"]


def test_an_id_cannot_leave_the_store(place_map: PlaceMap, address: StoreAddress) -> None:
    with pytest.raises(DataError, match="holds no map"):
        MapStore(address).load("../../etc")
    with pytest.raises(DataError, match="is no file name"):
        MapStore(address).save(replace(place_map, id="../x"))


def test_looking_into_an_empty_folder_writes_nothing(tmp_path: Path) -> None:
    assert MapStore(tmp_path / "none").list() == ()
    assert not (tmp_path / "none").exists()


def test_maps_of_the_old_format_are_imported(place_map: PlaceMap, address: StoreAddress) -> None:
    save_map_folder(renamed(place_map, "older"), address.root / f"{place_map.id}.000001")
    save_map_folder(place_map, address.root / f"{place_map.id}.000002")
    save_map_folder(place_map, address.root / "broken.000001")
    (address.root / "broken.000001" / "navigation" / "landmarks.ply").write_bytes(b"x")
    store = MapStore(address)
    with pytest.raises(DataError, match=f"its maps: broken, {place_map.id}$"):
        store.load("elsewhere")
    assert [(s.id, bool(s.damaged)) for s in store.list()] == [(place_map.id, False), ("broken", True)]
    assert store.load(place_map.id).name == place_map.name
    assert {p.name for p in (address.root / "imported").iterdir()} == {
        f"{place_map.id}.000001",
        f"{place_map.id}.000002",
    }
    assert len(MapStore(address).history(place_map.id)) == 1


def test_blobs_may_lie_in_an_object_store(place_map: PlaceMap, tmp_path: Path) -> None:
    address = StoreAddress(tmp_path, blobs=f"memory://{tmp_path.name}/maps")
    store = MapStore(address)
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, "Sofa")
    assert {p.name for p in tmp_path.iterdir()} == {"maps.db", ".lock"}
    (tmp_path / "maps.db").unlink()  # the records there are enough
    again = MapStore(address)
    assert again.load(place_map.id).places[0].name == "Sofa" and len(again.history(place_map.id)) == 2


def test_an_unusable_address_gets_a_sentence(place_map: PlaceMap, tmp_path: Path) -> None:
    for wrong in ("mysql://x/y", "no url", "postgresql://127.0.0.1:1/x"):
        with pytest.raises((ConfigError, DataError), match=r"store\.database|127\.0\.0\.1"):
            MapStore(StoreAddress(tmp_path, wrong)).save(place_map)
    with pytest.raises(ConfigError, match=r"store\.blobs"):
        MapStore(StoreAddress(tmp_path, blobs="nothing://x"))


def test_a_password_is_never_told(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(StoreAddress(tmp_path, "postgresql://user:secret-word@127.0.0.1:1/x"))
    with pytest.raises(DataError) as caught:
        store.save(place_map)
    assert "secret-word" not in str(caught.value) and "127.0.0.1" in str(caught.value)


@pytest.mark.parametrize(
    ("database", "blobs", "said"),
    [
        ("postgresql://u:SECRET@[::1/x", "", "store.database is no database URL"),
        ("postgresql://u:SECRET@host:x/y", "", "store.database is no database URL"),
        ("", "nothing://u:SECRET@host/x", "store.blobs = 'nothing://u:\\*\\*\\*@host/x' cannot be used"),
    ],
)
def test_an_address_that_is_none_is_a_sentence_without_its_password(
    tmp_path: Path, database: str, blobs: str, said: str
) -> None:
    with pytest.raises(ConfigError, match=said) as refused:
        MapStore(StoreAddress(tmp_path, database, blobs)).list()
    assert "SECRET" not in str(refused.value)


def test_a_database_is_named_by_its_path(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="by its path"):
        MapStore(StoreAddress(tmp_path, f"sqlite:///file:{tmp_path}/x.db?uri=true"))


@pytest.mark.parametrize("name", ["Shelf · 2", "Shelf · door side", "Place 99", "Sofa"])
def test_who_named_a_place_is_kept_with_it(place_map: PlaceMap, address: StoreAddress, name: str) -> None:
    store = MapStore(address)
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, name)
    kept = store.load(place_map.id)
    assert kept.places[0].name == name
    assert [place.named for place in kept.places] == [True, *(False for _ in place_map.places[1:])]


def test_a_record_from_before_that_was_kept_is_read_by_its_names_and_written_as_it_was(place_map: PlaceMap) -> None:
    place = place_map.places[0]
    for name, named in (("Shelf · 2", False), ("Shelf · door side", False), ("Place 7", False), ("Sofa", True)):
        old = encode_place(replace(place, name=name, named=named))
        assert "named" not in old
        [read] = decode_places([old])
        assert (read.name, read.named) == (name, named) and encode_place(read) == old
