"""A map of somebody else, its checksums right, whose places name what it does not hold, or that fills the memory."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shared.bounded import MAX_FILE_BYTES
from shared.errors import DataError
from station.maps.folder import load_map_folder, save_map_folder
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from tests.support.store import largest_blob

BAD_PLACES: dict[str, dict[str, Any]] = {
    "a landmark that is not there": {"landmark_index": np.array([0, 10**9])},
    "a landmark that is not": {"landmark_index": np.array([-1])},
    "a keyframe that is not there": {"keyframe_index": np.array([10**6])},
    "a keyframe that is not": {"representative_keyframe": 10**6},
    "an edge of it leads to a place": {"id": "place-elsewhere"},
}


def with_first_place(place_map: PlaceMap, changes: dict[str, Any]) -> PlaceMap:
    first, *others = place_map.places
    return replace(place_map, places=(replace(first, **changes), *others))


@pytest.mark.parametrize("said", BAD_PLACES)
def test_a_folder_or_store_whose_place_names_what_is_not_there_is_refused(
    place_map: PlaceMap, said: str, tmp_path: Path
) -> None:
    bad = with_first_place(place_map, BAD_PLACES[said])
    save_map_folder(bad, tmp_path / "map")
    with pytest.raises(DataError, match=said):
        load_map_folder(tmp_path / "map")
    store = MapStore(StoreAddress(tmp_path / "maps"))
    store.save(bad)
    with pytest.raises(DataError, match=said):
        store.load(bad.id)


def test_two_places_of_one_id_are_refused_and_places_without_pictures_are_not(
    place_map: PlaceMap, tmp_path: Path
) -> None:
    save_map_folder(replace(place_map, places=place_map.places[:1] * 2, edges=()), tmp_path / "two")
    with pytest.raises(DataError, match="two of its places have one id"):
        load_map_folder(tmp_path / "two")
    without = {"representative_keyframe": -1, "keyframe_index": np.array([], dtype=np.int64)}
    save_map_folder(with_first_place(place_map, without), tmp_path / "map")
    assert load_map_folder(tmp_path / "map").places[0].representative_keyframe == -1


def test_a_file_of_a_store_is_not_read_when_it_is_larger_than_any(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(StoreAddress(tmp_path / "maps"))
    store.save(place_map)
    path = largest_blob(store)
    os.truncate(path, MAX_FILE_BYTES + 1)  # a hole: nothing on the disk, and all of it in memory
    with pytest.raises(DataError, match="more than the 1024 MB that are read") as caught:
        store.load(place_map.id)
    assert path.name in str(caught.value)


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT count(i) AS version_num FROM n"


@pytest.mark.parametrize(
    "program",
    [
        ["ALTER TABLE alembic_version RENAME TO other", f"CREATE VIEW alembic_version AS {ENDLESS}"],
        [f"CREATE TRIGGER stays BEFORE INSERT ON map_version BEGIN {ENDLESS}; END"],
    ],
)
def test_an_index_that_would_compute_for_ever_is_made_again(
    place_map: PlaceMap, program: list[str], tmp_path: Path
) -> None:
    folder = tmp_path / "maps"
    MapStore(StoreAddress(folder)).save(place_map)
    with contextlib.closing(sqlite3.connect(folder / "maps.db")) as foreign:
        for statement in program:
            foreign.execute(statement)
    told: list[str] = []
    store = MapStore(StoreAddress(folder), notify=told.append)
    assert [summary.id for summary in store.list()] == [place_map.id]
    store.save(place_map)
    assert "as no station makes" in told[0] and len(list(folder.glob("maps.db.damaged-*"))) == 1
