"""A folder that takes no writes shows every map, refuses every change, and is repaired once it takes them again."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from shared.errors import DataError
from station.files.unwritable import Unwritable
from station.maps.backup import restore_backup, write_backup
from station.maps.folder import save_map_folder
from station.maps.index_copy import FORGOTTEN_S, IN_USE, PREFIX
from station.maps.repair.check import repair, verify
from station.maps.repair.purging import purge, purge_versions
from station.maps.store import MapStore
from station.model.place_map import PlaceMap
from tests.support.disk import unwritable
from tests.support.store import content_hash, rename_place

NAMED = "Sofa"


@pytest.fixture(autouse=True)
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where copies are made; nothing may be left in it."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


@pytest.fixture
def root(tmp_path: Path, place_map: PlaceMap) -> Path:
    """A store with a map of two versions."""
    store = MapStore(tmp_path / "maps")
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, NAMED)
    return tmp_path / "maps"


def cut_transaction(root: Path) -> None:
    """What a writer leaves that is killed in the middle of its transaction: pages written, the journal still there."""
    whole = root / "whole.db"
    shutil.copyfile(root / "maps.db", whole)
    with contextlib.closing(sqlite3.connect(whole, isolation_level=None)) as writer:
        writer.execute("PRAGMA cache_size = 1")  # so that it writes before it commits
        writer.execute("BEGIN IMMEDIATE")
        writer.execute("DELETE FROM map_version")
        row = ("x", "saved", "x" * 300, 1, "n", 1, "r", "s", "a")
        for number in range(500):
            writer.execute("INSERT INTO map_version VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", (row[0], number, *row[1:]))
        shutil.copyfile(whole, root / "maps.db")
        shutil.copyfile(root / "whole.db-journal", root / "maps.db-journal")
    whole.unlink()
    assert (root / "maps.db-journal").stat().st_size


def lose_row(root: Path) -> None:
    """What a writer leaves that is killed between its record and its commit."""
    with contextlib.closing(sqlite3.connect(root / "maps.db")) as connection:
        connection.execute("DELETE FROM map_version WHERE number = 2")
        connection.commit()


def break_index(root: Path) -> None:
    (root / "maps.db").write_bytes(b"SQLite format 3\0" + bytes(1000))


def remove_index(root: Path) -> None:
    (root / "maps.db").unlink()


def snapshot(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def name_of_place(store: MapStore, place_map: PlaceMap) -> str:
    return store.load(place_map.id).places[0].name


@pytest.mark.parametrize("harm", [cut_transaction, lose_row, break_index, remove_index])
def test_all_maps_are_seen_and_none_can_be_changed(
    harm: object, root: Path, place_map: PlaceMap, tmp_path: Path
) -> None:
    backup = tmp_path / "backup.tar"
    write_backup(MapStore(root), backup)
    assert callable(harm)
    harm(root)
    before = snapshot(root)
    told: list[str] = []
    with unwritable(root):
        store = MapStore(root, told.append)
        assert [summary.id for summary in store.list()] == [place_map.id]
        assert name_of_place(store, place_map) == NAMED
        assert [record.number for record in store.history(place_map.id)] == [2, 1]
        assert verify(store) == () and store.newest_of_navigation("nav-1") is not None
        write_backup(store, tmp_path / "again.tar")
        assert sum("can be seen, not changed" in sentence for sentence in told) == 1
        for change in (
            lambda: store.save(replace(place_map, name="other")),
            lambda: rename_place(store, place_map.id, place_map.places[0].id, "Desk"),
            lambda: store.delete(place_map.id),
            lambda: store.undo(place_map.id),
            lambda: purge(store.for_writing(), place_map.id),
            lambda: purge_versions(store.for_writing(), place_map.id),
            lambda: repair(store),
            lambda: restore_backup(store, backup),
            store.require_writable,
        ):
            with pytest.raises(Unwritable, match=r"cannot be written \((Read-only|Permission)") as refused:
                change()
            assert str(root) in str(refused.value) and "\n" not in str(refused.value)
        assert snapshot(root) == before
    # It takes writes again: the same store is repaired at its next use, and so is a new one.
    rename_place(store, place_map.id, place_map.places[0].id, "Desk")
    assert not store.is_copy
    assert name_of_place(MapStore(root), place_map) == "Desk" and verify(MapStore(root)) == ()
    assert not (root / "maps.db-journal").exists()
    store.close()


def test_a_sound_store_needs_no_copy_and_says_the_same_to_every_change(root: Path, place_map: PlaceMap) -> None:
    told: list[str] = []
    store = MapStore(root, told.append)
    with unwritable(root):
        assert name_of_place(store, place_map) == NAMED and verify(store) == ()
        for change in (
            lambda: store.save(replace(place_map, name="other")),
            lambda: store.delete(place_map.id),
            lambda: store.undo(place_map.id),
            store.require_writable,
        ):
            with pytest.raises(Unwritable, match=r"cannot be written \((Read-only|Permission)") as refused:
                change()
            assert str(root) in str(refused.value)
        assert not store.is_copy and told == []
    assert name_of_place(store, place_map) == NAMED


def test_a_folder_without_maps_says_the_same(root: Path, place_map: PlaceMap) -> None:
    with unwritable(root):
        store = MapStore(root / "none", lambda _: None)
        assert store.list() == ()
        with pytest.raises(Unwritable, match=r"none cannot be written \((Read-only|Permission)"):
            store.save(place_map)
        assert store.list() == ()
    store.save(place_map)
    assert [summary.id for summary in store.list()] == [place_map.id]


def test_a_write_that_is_cut_while_the_store_is_open_hides_no_map(root: Path, place_map: PlaceMap) -> None:
    store = MapStore(root, lambda _: None)
    assert store.list()
    cut_transaction(root)
    with unwritable(root):
        assert [summary.id for summary in store.list()] == [place_map.id]
        assert name_of_place(store, place_map) == NAMED
    assert name_of_place(store, place_map) == NAMED and not store.is_copy
    store.close()


def test_maps_of_the_old_format_are_seen_and_taken_in_later(root: Path, place_map: PlaceMap) -> None:
    save_map_folder(replace(place_map, id="older"), root / "older.000001")
    with unwritable(root):
        store = MapStore(root, lambda _: None)
        assert {(s.id, s.damaged) for s in store.list()} == {(place_map.id, ""), ("older", "")}
        seen = content_hash(store, "older")
        assert (root / "older.000001").is_dir()
    assert content_hash(store, "older") == seen
    assert not (root / "older.000001").exists()
    store.close()


def test_a_wrong_bit_in_a_folder_that_takes_no_writes_is_not_said_to_be_put_right(
    root: Path, place_map: PlaceMap
) -> None:
    lose_row(root)
    blob = max((root / "blobs").rglob("*-*"), key=lambda path: path.stat().st_size)
    data = bytearray(blob.read_bytes())
    data[7] ^= 1
    blob.write_bytes(bytes(data))
    told: list[str] = []
    with unwritable(root):
        store = MapStore(root, told.append)
        assert name_of_place(store, place_map) == NAMED
        assert any("it is used put right" in sentence for sentence in told)
    store.close()


def test_what_another_user_changes_is_seen(root: Path, place_map: PlaceMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """For us the folder takes no writes; who owns it goes on."""
    lose_row(root)
    with unwritable(root):
        store = MapStore(root, lambda _: None)
        assert store.list() and store.is_copy
        monkeypatch.setattr("station.maps.index_copy.why_unwritable", lambda _: OSError(13, "Permission denied"))
    rename_place(MapStore(root), place_map.id, place_map.places[0].id, "Desk")
    assert name_of_place(store, place_map) == "Desk"
    store.close()


def test_nowhere_to_copy_to_is_one_sentence(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> str:
        raise OSError(28, "No space left on device")

    lose_row(root)
    monkeypatch.setattr(tempfile, "mkdtemp", full)
    with unwritable(root), pytest.raises(DataError, match=r"maps\.db cannot be"):
        MapStore(root, lambda _: None).list()


def test_copies_of_programs_that_were_killed_are_cleared_up(
    root: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lose_row(root)
    left = scratch / f"{PREFIX}left"
    left.mkdir()
    (left / IN_USE).touch()
    monkeypatch.setattr("station.maps.index_copy.FORGOTTEN_S", -1.0)
    with unwritable(root):
        store, other = MapStore(root, lambda _: None), MapStore(root, lambda _: None)
        assert store.list() and other.list()
        assert not left.exists() and len(list(scratch.iterdir())) == 2  # and not one that is in use
        del store
        assert len(list(scratch.iterdir())) == 1
        other.close()
    assert FORGOTTEN_S > 0
