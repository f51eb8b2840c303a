"""Records that were lost together with the index, and files that only they need."""

from __future__ import annotations

import io
import os
import shutil
import tarfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy.engine import Connection
from typer.testing import CliRunner

from shared.errors import DataError
from station.main import app
from station.maps import versions
from station.maps.backup import README, README_BEFORE_LISTS, README_NAME, restore_backup, write_backup
from station.maps.blobs import RENEWED_AFTER_S, blob_name
from station.maps.editing import with_place_renamed
from station.maps.repair.check import repair, verify
from station.maps.repair.purging import UNUSED_S, collect_garbage, purge_versions, tidy_up
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from tests.support.store import blobs, cut, largest_blob, newest_record, rename_place


@pytest.fixture
def root(place_map: PlaceMap, tmp_path: Path) -> Path:
    """A store with a map of three versions, which nobody has open."""
    store = MapStore(StoreAddress(tmp_path / "maps"))
    store.save(place_map)
    for name in ("Sofa", "Couch"):
        rename_place(store, place_map.id, place_map.places[0].id, name)
    store.close()
    return tmp_path / "maps"


def opened(root: Path) -> MapStore:
    return MapStore(StoreAddress(root))


def records(root: Path) -> list[Path]:
    return sorted((root / "records").iterdir())


def make_old(root: Path) -> None:
    """As if nobody had touched it for two days."""
    for path in root.rglob("*"):
        os.utime(path, (time.time() - 2 * UNUSED_S,) * 2)


def test_the_newest_record_that_is_lost_with_the_index_is_told_until_it_is_set_aside(
    place_map: PlaceMap, tmp_path: Path
) -> None:
    store = MapStore(StoreAddress(tmp_path / "maps"))
    store.save(place_map)
    store.delete(place_map.id)
    store.undo(place_map.id)
    store.close()
    cut(newest_record(store))
    cut(tmp_path / "maps" / "maps.db")
    for _ in range(2):  # the index is made again by the first
        again = MapStore(StoreAddress(tmp_path / "maps"))
        assert [(damage.map_id, damage.number) for damage in verify(again)] == [(place_map.id, 3)]
        again.close()
    told = CliRunner().invoke(app, ["map", "verify", "--data", str(tmp_path)])
    assert told.exit_code == 1 and "is damaged" in told.output and "as they were written" not in told.output
    again = MapStore(StoreAddress(tmp_path / "maps"))
    done = repair(again)
    assert done.left == () and verify(again) == ()
    assert any("version 3" in said and f"station map undo {place_map.id}" in said for said in done.done)
    assert len(list((tmp_path / "maps" / "damaged").iterdir())) == 1
    again.undo(place_map.id)
    assert again.load(place_map.id).name == place_map.name
    again.delete(place_map.id)
    purge_versions(again.for_writing(), place_map.id)
    left = [*(tmp_path / "maps" / "records").iterdir(), *(tmp_path / "maps" / "damaged").iterdir()]
    assert left == [] and verify(again) == ()


def test_a_map_that_lacks_a_file_is_told_and_nothing_of_it_is_tidied_away(
    root: Path, place_map: PlaceMap, tmp_path: Path
) -> None:
    lost = largest_blob(opened(root))
    shutil.copytree(root, tmp_path / "copy")
    lost.unlink()
    cut(root / "maps.db")
    make_old(root)
    for _ in range(2):  # the index is made again by the first, without this map
        store = opened(root)
        assert {(damage.map_id, damage.address) for damage in verify(store)} == {(place_map.id, lost.name)}
        store.close()
    store = opened(root)
    before = set(blobs(store))
    result = repair(store)
    assert {damage.address for damage in result.left} == {lost.name} and set(blobs(store)) == before
    result = repair(store, [tmp_path / "copy"])
    assert result.left == () and verify(store) == ()
    assert store.load(place_map.id).places[0].name == "Couch"
    assert len(store.history(place_map.id)) == 3


def test_an_older_version_that_is_lost_with_the_index_is_told_until_it_is_set_aside(root: Path) -> None:
    cut(records(root)[1])
    cut(root / "maps.db")
    for _ in range(2):
        store = opened(root)
        assert [damage.number for damage in verify(store)] == [2]
        store.close()
    store = opened(root)
    assert any("version 2" in said and "at version 3" in said for said in repair(store).done)
    assert verify(store) == ()


def test_a_lost_record_comes_from_a_copy_where_there_is_one(root: Path, place_map: PlaceMap, tmp_path: Path) -> None:
    shutil.copytree(root, tmp_path / "copy")
    cut(newest_record(opened(root)))
    cut(root / "maps.db")
    store = opened(root)
    result = repair(store, [tmp_path / "copy"])
    assert result.left == () and verify(store) == () and not (root / "damaged").exists()
    assert [record.number for record in store.history(place_map.id)] == [3, 2, 1]


def test_a_record_with_a_row_comes_from_a_copy_too(root: Path, place_map: PlaceMap, tmp_path: Path) -> None:
    shutil.copytree(root, tmp_path / "copy")
    cut(records(root)[1])
    records(root)[2].unlink()
    store = opened(root)
    assert {damage.number for damage in verify(store)} == {2, 3}
    assert repair(store, [tmp_path / "copy"]).left == () and verify(store) == ()
    assert store.load(place_map.id).places[0].name == "Couch"


def test_a_map_of_which_nothing_is_left_can_be_purged(root: Path, place_map: PlaceMap) -> None:
    for record in records(root):
        cut(record)
    cut(root / "maps.db")
    store = opened(root)
    repair(store)
    assert len(list((root / "damaged").iterdir())) == 3 and verify(store) == ()
    assert any("nothing was tidied up" in said for said in repair(store).done)
    make_old(root)
    said = purge_versions(store.for_writing(), place_map.id)
    assert said[0] == f"{place_map.id} is gone" and "unused files were removed" in said[1]
    assert list(blobs(store)) == [] and list((root / "damaged").iterdir()) == []


def test_a_map_whose_every_version_is_damaged_can_be_purged(root: Path, place_map: PlaceMap, tmp_path: Path) -> None:
    for record in records(root):
        cut(record)
    said = CliRunner().invoke(app, ["map", "purge", place_map.id, "--yes", "--data", str(tmp_path)])
    assert said.exit_code == 0 and "earlier versions" in said.output
    assert len(records(root)) == 1


def test_what_was_tidied_as_unused_is_not_what_somebody_saves_again(root: Path, place_map: PlaceMap) -> None:
    store = opened(root)
    make_old(root)
    address = largest_blob(store).name
    data = (root / blob_name(address)).read_bytes()
    assert time.time() - (root / blob_name(address)).stat().st_mtime > RENEWED_AFTER_S
    assert store.contents.blobs.put([data]) == [address]
    assert not store.contents.blobs.remove(address, UNUSED_S)  # it was old when the tidying listed it
    assert verify(store) == ()
    make_old(root)
    assert store.contents.blobs.remove(address, UNUSED_S) and verify(store) != ()


def test_what_a_killed_writer_left_is_tidied_away_unasked(root: Path, place_map: PlaceMap) -> None:
    store = opened(root)
    left = root / blob_name(store.for_writing().blobs.put([b"of a build that was killed"])[0])
    tidy_up(store)
    assert left.exists()  # it may be of one that goes on
    make_old(root)
    tidy_up(store)
    assert not left.exists() and verify(store) == ()
    assert store.load(place_map.id).places[0].name == "Couch"


def save(store: MapStore, place_map: PlaceMap) -> None:
    store.save(place_map)


def rename(store: MapStore, place_map: PlaceMap) -> None:
    store.edit(place_map.id, lambda before: with_place_renamed(before, before.places[0].id, "Chair"), "")


def build(store: MapStore, place_map: PlaceMap) -> None:
    store.rebuild(place_map, place_map.navigation.id, lambda built, _: built, "built")


def restore(store: MapStore, _: PlaceMap) -> None:
    restore_backup(store, store.address.root.parent / "maps.tar")


@pytest.mark.parametrize("write", [save, rename, build, restore])
def test_whoever_writes_a_map_loses_nothing_to_a_station_that_starts_with_a_wrong_clock(
    write: Callable[[MapStore, PlaceMap], None], root: Path, place_map: PlaceMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files are written, its record is not yet, and to others they look old."""
    changed = replace(place_map, name="again", places=place_map.places[:1])
    elsewhere = MapStore(root.parent / "elsewhere")
    elsewhere.save(changed)
    write_backup(elsewhere, root.parent / "maps.tar")
    store, other = opened(root), opened(root)
    add_really = versions.add
    said: list[str] = []

    def add_late(connection: Connection, rows: list[versions.VersionRow]) -> None:
        monkeypatch.setattr("station.maps.repair.purging.UNUSED_S", -1.0)
        said.extend(collect_garbage(other.for_writing()))
        monkeypatch.undo()
        add_really(connection, rows)

    other.open()
    monkeypatch.setattr(versions, "add", add_late)
    write(store, changed)
    assert set(said) == {"nothing was tidied up: a map is being written"} and verify(store) == ()


def test_text_in_the_index_that_is_none_is_a_damaged_index(root: Path, place_map: PlaceMap) -> None:
    index = root / "maps.db"
    content = index.read_bytes()
    assert content.count(b"NOT NULL") > 1
    index.write_bytes(content.replace(b"NOT NULL", b"NOT N\xd5LL", 1))  # sqlite3 cannot even quote it
    told: list[str] = []
    store = MapStore(StoreAddress(root), told.append)
    assert store.load(place_map.id).places[0].name == "Couch"
    assert any("is damaged" in said for said in told)


def run(*words: str, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["map", *words])
    assert result.exit_code == code, result.output
    return result.output


def test_a_wrong_bit_in_a_backup_is_put_right_too(root: Path, place_map: PlaceMap, tmp_path: Path) -> None:
    backup = tmp_path / "b.tar"
    run("backup", str(backup), "--data", str(root.parent))
    content = bytearray(backup.read_bytes())
    largest = largest_blob(opened(root)).read_bytes()
    content[bytes(content).index(largest) + len(largest) // 2] ^= 4
    backup.write_bytes(content)
    assert "had one wrong bit" in run("restore", str(backup), "--data", str(tmp_path / "other"))
    restored = opened(tmp_path / "other" / "maps")
    assert verify(restored) == () and restored.load(place_map.id).places[0].name == "Couch"


@pytest.mark.parametrize("which", [1, -2, -1])  # a record with a long name, the last file, the list of them
def test_a_wrong_bit_in_a_header_of_a_backup_is_put_right(
    root: Path, place_map: PlaceMap, tmp_path: Path, which: int
) -> None:
    backup = tmp_path / "b.tar"
    run("backup", str(backup), "--data", str(root.parent))
    content = bytearray(backup.read_bytes())
    with tarfile.open(backup) as archive:
        member = archive.getmembers()[which]
    content[member.offset_data - 512 + 30] ^= 4  # of its name
    backup.write_bytes(content)
    told = run("restore", str(backup), "--data", str(tmp_path / "other"))
    assert f"the header of {member.name[:40]}" in told and "was wrong; it is put right" in told
    restored = opened(tmp_path / "other" / "maps")
    assert verify(restored) == () and len(restored.history(place_map.id)) == 3


@pytest.mark.parametrize(("bits", "code", "said"), [(1, 0, "had one wrong bit"), (2, 1, "its list is damaged")])
def test_a_damaged_list_costs_no_map(
    root: Path, place_map: PlaceMap, tmp_path: Path, bits: int, code: int, said: str
) -> None:
    backup = tmp_path / "b.tar"
    run("backup", str(backup), "--data", str(root.parent))
    content = bytearray(backup.read_bytes())
    with tarfile.open(backup) as archive:
        begin = archive.getmembers()[-1].offset_data
    for number in range(bits):
        content[begin + number] ^= 1
    backup.write_bytes(content)
    assert said in run("restore", str(backup), "--data", str(tmp_path / "other"), code=code)
    assert len(opened(tmp_path / "other" / "maps").history(place_map.id)) == 3


@pytest.mark.parametrize(("readme", "code"), [(README_BEFORE_LISTS, 0), (README, 1), (None, 1)])
def test_a_backup_without_a_list_is_read_and_one_that_had_it_is_told(
    root: Path, place_map: PlaceMap, tmp_path: Path, readme: bytes | None, code: int
) -> None:
    whole, without = tmp_path / "b.tar", tmp_path / "c.tar"
    run("backup", str(whole), "--data", str(root.parent))
    with tarfile.open(whole) as archive, tarfile.open(without, "w") as out:
        if readme is not None:
            member = tarfile.TarInfo(README_NAME)
            member.size = len(readme)
            out.addfile(member, io.BytesIO(readme))
        for member in archive.getmembers()[1:-1]:
            out.addfile(member, archive.extractfile(member))
    told = run("restore", str(without), "--data", str(tmp_path / "other"), code=code)
    assert ("its list is missing" in told) == bool(code)
    assert len(opened(tmp_path / "other" / "maps").history(place_map.id)) == 3


def test_a_backup_of_which_records_and_list_were_taken_out_is_refused(root: Path, tmp_path: Path) -> None:
    whole, without = tmp_path / "b.tar", tmp_path / "c.tar"
    run("backup", str(whole), "--data", str(root.parent))
    with tarfile.open(whole) as archive, tarfile.open(without, "w") as out:
        for member in archive.getmembers():
            if not member.name.startswith(("records/", "contents/")):
                out.addfile(member, archive.extractfile(member))
    with pytest.raises(DataError, match="its list is missing"):
        restore_backup(opened(tmp_path / "other"), without)


@pytest.mark.parametrize("kind", ["records", "blobs"])
def test_what_somebody_took_out_of_a_backup_is_told(root: Path, tmp_path: Path, kind: str) -> None:
    whole, without = tmp_path / "b.tar", tmp_path / "c.tar"
    run("backup", str(whole), "--data", str(root.parent))
    with tarfile.open(whole) as archive, tarfile.open(without, "w") as out:
        members = archive.getmembers()
        taken = [member for member in members if member.name.startswith(f"{kind}/")][-1]
        for member in members:
            if member != taken:
                out.addfile(member, archive.extractfile(member))
    told = run("restore", str(without), "--data", str(tmp_path / "other"), code=1)
    assert f"1 of the {len(members) - 1} files that its list names are missing" in told
    assert taken.name[:40] in told


def test_what_a_cut_backup_lacks_may_come_from_elsewhere(root: Path, place_map: PlaceMap, tmp_path: Path) -> None:
    backup, data = tmp_path / "b.tar", tmp_path / "other"
    run("backup", str(backup), "--data", str(root.parent))
    backup.write_bytes(backup.read_bytes()[: backup.stat().st_size // 2])
    told = run("restore", str(backup), "--data", str(data), code=1)
    assert "ends early" in told and "`station map repair FOLDER` brings it in" in told
    assert run("verify", "--data", str(data), code=1).count("is missing") >= 1
    run("repair", str(root), "--data", str(data))
    restored = opened(data / "maps")
    assert verify(restored) == () and restored.load(place_map.id).places[0].name == "Couch"
    assert len(restored.history(place_map.id)) == 3


def test_a_mistyped_folder_is_no_sound_store(root: Path, tmp_path: Path) -> None:
    for words in (["verify"], ["repair"], ["backup", str(tmp_path / "b.tar")]):
        result = CliRunner().invoke(app, ["map", *words, "--data", str(tmp_path / "nowhere")])
        assert isinstance(result.exception, DataError) and "--data" in str(result.exception)
    (tmp_path / "new").mkdir()
    assert "no maps in" in run("verify", "--data", str(tmp_path / "new"))


def test_what_was_lost_is_listed_with_hints_that_reach_the_same_folder(root: Path, place_map: PlaceMap) -> None:
    store = opened(root)
    store.delete(place_map.id)
    store.undo(place_map.id)
    store.close()
    cut(newest_record(store))
    cut(root / "maps.db")
    data = ("--data", str(root.parent))
    assert f"`station map undo {place_map.id} --data {root.parent}`" in run("repair", *data)
    assert f"version 5 of map {place_map.id} was lost" in run("verify", *data)
