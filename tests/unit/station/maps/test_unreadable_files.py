"""A file that cannot be read, for a bad sector say, costs what needs it and nothing else."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from shared.errors import DataError
from station.maps.backup import restore_backup, write_backup
from station.maps.repair.check import repair, verify
from station.maps.repair.purging import collect_garbage
from station.maps.store import MapStore
from station.model.place_map import PlaceMap
from tests.support.disk import BadSectors
from tests.support.store import blobs, largest_blob, newest_record, rename_place


@pytest.fixture
def root(place_map: PlaceMap, tmp_path: Path) -> Path:
    """Two maps; the first one, of two versions, shares most of its files with the other."""
    store = MapStore(tmp_path / "maps")
    store.save(replace(place_map, id="another"))
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, "Sofa")
    store.close()
    return tmp_path / "maps"


def bad_sector(path: Path, sectors: BadSectors) -> None:
    sectors.paths.add(path)


def pipe(path: Path, _: BadSectors) -> None:
    path.unlink()
    os.mkfifo(path)


def too_large(path: Path, _: BadSectors) -> None:
    os.truncate(path, 1100 * 2**20)


Harm = Callable[[Path, BadSectors], None]


@pytest.fixture
def sectors(monkeypatch: pytest.MonkeyPatch) -> BadSectors:
    return BadSectors(monkeypatch)


@pytest.mark.parametrize("harm", [bad_sector, pipe, too_large])
def test_a_record_that_cannot_be_read_costs_its_version(
    root: Path, place_map: PlaceMap, sectors: BadSectors, tmp_path: Path, harm: Harm
) -> None:
    record = newest_record(MapStore(root))
    harm(record, sectors)
    told: list[str] = []
    store = MapStore(root, told.append)
    assert {one.id for one in store.list()} == {"another", place_map.id}
    assert store.load(place_map.id).places[0].name == place_map.places[0].name
    assert record.name in told[-1] and "cannot be read" in told[-1] and "Version 1" in told[-1]
    assert [one.map_id for one in store.records()] == ["another"]
    assert [one.number for one in store.history(place_map.id)] == [1]
    [damage] = verify(store)
    assert damage.number == 2 and "cannot be read" in damage.sentence
    report = write_backup(store, tmp_path / "b.tar")
    assert (report.maps, report.versions, len(report.damaged)) == (2, 2, 1)
    assert "damaged version" in collect_garbage(store.contents)[0]
    assert f"map {place_map.id} is again what it was at version 1" in repair(store).done
    assert restore_backup(store, tmp_path / "b.tar").maps == 2


@pytest.mark.parametrize("harm", [bad_sector, pipe, too_large])
def test_a_record_without_a_row_that_cannot_be_read_keeps_no_store_from_opening(
    root: Path, place_map: PlaceMap, sectors: BadSectors, tmp_path: Path, harm: Harm
) -> None:
    stray = newest_record(MapStore(root)).with_name(f"stray.000009.{newest_record(MapStore(root)).name[-73:]}")
    stray.write_bytes(b"anything")
    harm(stray, sectors)
    store = MapStore(root, lambda _: None)
    assert store.load(place_map.id).places[0].name == "Sofa"
    [damage] = verify(store)
    assert damage.map_id == "stray" and "cannot be read" in damage.sentence
    repair(store)
    assert stray.exists()  # somebody else may read more of it
    assert write_backup(store, tmp_path / "b.tar").versions == 3


def test_a_file_that_cannot_be_read_is_named_and_written_anew(
    root: Path, place_map: PlaceMap, sectors: BadSectors, tmp_path: Path
) -> None:
    write_backup(MapStore(root), tmp_path / "whole.tar")
    blob = largest_blob(MapStore(root))
    bad_sector(blob, sectors)
    store = MapStore(root, lambda _: None)
    with pytest.raises(DataError, match=rf"{blob.name} cannot be read \(Input/output error\)"):
        store.load(place_map.id)
    assert [one.address for one in verify(store)] == [blob.name]
    assert len(write_backup(store, tmp_path / "b.tar").damaged) == 1
    copy = tmp_path / "copies" / "one"
    copy.parent.mkdir()
    copy.write_bytes(blob.read_bytes())
    bad_sector(copy, sectors)
    assert [one.address for one in repair(store, [copy.parent]).left] == [blob.name]
    sectors.paths.discard(blob)  # what is written anew comes to another sector
    blob.write_bytes(b"")
    assert restore_backup(store, tmp_path / "whole.tar").damaged == ()
    assert verify(store) == ()


def test_saving_writes_what_cannot_be_read_anew(
    root: Path, place_map: PlaceMap, sectors: BadSectors, monkeypatch: pytest.MonkeyPatch
) -> None:
    blob = largest_blob(MapStore(root))
    pipe(blob, sectors)
    store = MapStore(root, lambda _: None)
    store.save(replace(place_map, name="again"))
    assert blob.is_file() and verify(store) == ()


def test_what_could_not_be_read_again_is_not_written(
    place_map: PlaceMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("station.maps.bucket.MAX_FILE_BYTES", 2000)
    store = MapStore(tmp_path / "maps")
    with pytest.raises(DataError, match="more than the"):
        store.save(place_map)
    assert store.list() == () and [path for path in blobs(store) if path.stat().st_size > 2000] == []


def test_whoever_may_not_read_a_file_does_not_take_it_for_damaged(
    root: Path, place_map: PlaceMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path, max_bytes: int) -> bytes:
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr("station.maps.bucket.read_file", refused)
    with pytest.raises(DataError, match="Permission denied"):
        repair(MapStore(root))
