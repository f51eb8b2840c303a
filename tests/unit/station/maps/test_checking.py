"""What is damaged is found, named, and put right where that is possible; backups bring everything back."""

from __future__ import annotations

import json
import math
import sqlite3
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from shared.errors import DataError
from station.files.navigation_folder import save_navigation
from station.main import app
from station.maps import versions
from station.maps.address import address_of, heal, is_nearly, wrong_bits
from station.maps.backup import restore_backup, write_backup
from station.maps.blobs import Damaged
from station.maps.record import decode_record, encode_record, map_content_hash
from station.maps.repair.check import repair, verify
from station.maps.repair.purging import purge_versions
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from tests.support.hostile_files import backup_with_records
from tests.support.store import blobs, content_hash, cut, largest_blob, newest_record, rename_place


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def store(place_map: PlaceMap, address: StoreAddress, told: list[str]) -> MapStore:
    """A map of three versions."""
    store = MapStore(address, told.append)
    store.save(place_map)
    for name in ("Sofa", "Couch"):
        rename_place(store, place_map.id, place_map.places[0].id, name)
    return store


@given(data=st.binary(min_size=1, max_size=300), position=st.floats(0, 1, exclude_max=True), second=st.booleans())
def test_one_wrong_bit_is_put_right_and_never_more(data: bytes, position: float, second: bool) -> None:
    bit = int(position * 8 * len(data))
    wrong = bytearray(data)
    wrong[bit // 8] ^= 1 << bit % 8
    if second:
        wrong[-1 if bit // 8 < len(data) - 1 else 0] ^= 1 << (bit + 1) % 8
    assert heal(bytes(wrong), address_of(data)) == (None if second else data)


@pytest.mark.parametrize(("found", "bits"), [(b"SntM", 0), (b"SntL", 1), (b"SltL", 2), (b"Snt", 32), (b"", 32)])
def test_wrong_bits_are_counted_and_all_are_wrong_of_another_length(found: bytes, bits: int) -> None:
    assert wrong_bits(found, b"SntM") == bits and is_nearly(found, b"SntM") == (bits <= 1)


def test_a_sound_store_is_called_sound(store: MapStore, told: list[str]) -> None:
    assert verify(store) == () and told == []
    assert repair(store).done == ()


def test_a_wrong_bit_in_a_file_is_told_and_put_right(place_map: PlaceMap, store: MapStore, told: list[str]) -> None:
    path = largest_blob(store)
    whole = path.read_bytes()
    path.write_bytes(bytes([whole[0] ^ 4]) + whole[1:])
    assert store.load(place_map.id).places[0].name == "Couch"
    assert path.read_bytes() == whole
    assert len(told) == 1 and path.name in told[0] and "one wrong bit" in told[0]


def test_where_the_newest_version_is_lost_the_one_before_opens(
    place_map: PlaceMap, store: MapStore, told: list[str]
) -> None:
    cut(newest_record(store))
    assert store.load(place_map.id).places[0].name == "Sofa"
    assert "version 3" in told[0] and "version 2" in told[0].lower()
    assert [d.number for d in verify(store)] == [3]
    done = repair(store)
    assert any("again what it was at version 2" in sentence for sentence in done.done)
    told.clear()
    assert store.load(place_map.id).places[0].name == "Sofa" and told == []


def test_a_lost_file_is_named_and_copied_from_the_navigation(
    place_map: PlaceMap, store: MapStore, tmp_path: Path
) -> None:
    path = largest_blob(store)
    path.unlink()
    with pytest.raises(Damaged, match=path.name):
        store.load(place_map.id)
    assert [d.address for d in verify(store)] == [path.name]
    assert repair(store).left != ()
    save_navigation(place_map.navigation, tmp_path / "copy")
    assert repair(store, [tmp_path / "copy"]).left == ()
    assert store.load(place_map.id).places[0].name == "Couch"


def test_a_wrong_row_is_noticed_and_made_again(place_map: PlaceMap, store: MapStore) -> None:
    with store.contents.database.writing("test") as connection:
        connection.execute(sqlalchemy.text("UPDATE map_version SET name = 'x' WHERE number = 3"))
    assert "seal" in store.list()[0].damaged
    assert store.load(place_map.id).places[0].name == "Sofa"
    assert repair(MapStore(store.address)).left == ()
    assert store.load(place_map.id).places[0].name == "Couch"
    assert verify(store) == ()


def test_a_broken_sqlite_file_is_set_aside_and_made_again(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(tmp_path)
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, "Sofa")
    index = tmp_path / "maps.db"
    for content in (b"no database" * 100, index.read_bytes()[:5000], b""):
        index.write_bytes(content)
        told: list[str] = []
        again = MapStore(tmp_path, told.append)
        assert again.load(place_map.id).places[0].name == "Sofa"
        assert len(again.history(place_map.id)) == 2
        assert bool(told) == bool(content)  # an empty file is one that was never written
    assert len(list(tmp_path.glob("maps.db.damaged-*"))) == 2


def test_a_record_whose_writer_was_killed_is_taken_in(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(tmp_path)
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, "Sofa")
    with sqlite3.connect(tmp_path / "maps.db") as connection:
        connection.execute("DELETE FROM map_version WHERE number = 2")
    connection.close()
    again = MapStore(tmp_path)
    assert again.load(place_map.id).places[0].name == "Sofa"
    with again.reading() as reading:
        assert [row.number for row in versions.history(reading, place_map.id)] == [2, 1]


def test_a_backup_brings_everything_back(place_map: PlaceMap, store: MapStore, tmp_path: Path) -> None:
    report = write_backup(store, tmp_path / "b.tar")
    assert (report.maps, report.versions, report.damaged) == (1, 3, ())
    with pytest.raises(DataError, match="exists already"):
        write_backup(store, tmp_path / "b.tar")
    other = MapStore(tmp_path / "other")
    assert restore_backup(other, tmp_path / "b.tar").versions == 3
    assert content_hash(other, place_map.id) == content_hash(store, place_map.id)
    assert [r.why for r in other.history(place_map.id)] == [r.why for r in store.history(place_map.id)]
    assert restore_backup(other, tmp_path / "b.tar").versions == 0
    rename_place(other, place_map.id, place_map.places[0].id, "Bench")
    other.delete(place_map.id)
    assert restore_backup(other, tmp_path / "b.tar").versions == 0  # its history has it: undo brings it back
    other.undo(place_map.id, to=1)
    assert content_hash(other, place_map.id) == map_content_hash(place_map)


def test_a_file_of_zeros_is_no_backup(tmp_path: Path) -> None:
    (tmp_path / "b.tar").write_bytes(bytes(tarfile.RECORDSIZE))  # an archive's end, and nothing before it
    with pytest.raises(DataError, match="holds nothing"):
        restore_backup(MapStore(tmp_path / "other"), tmp_path / "b.tar")


def test_what_is_no_part_of_a_backup_is_told_and_left_out(store: MapStore, tmp_path: Path) -> None:
    write_backup(store, tmp_path / "b.tar")
    with tarfile.open(tmp_path / "b.tar", "a") as archive:
        for kind, name in ((tarfile.SYMTYPE, "maps/\x1b[31mlink"), (tarfile.REGTYPE, "notes.txt")):
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, "/etc/passwd"
            archive.addfile(member)
    report = restore_backup(MapStore(tmp_path / "other"), tmp_path / "b.tar")
    [sentence] = report.damaged
    assert report.versions == 3
    assert "2 in all" in sentence and "link" in sentence and "\x1b" not in sentence


def test_a_damaged_backup_gives_what_is_whole(place_map: PlaceMap, store: MapStore, tmp_path: Path) -> None:
    backup = tmp_path / "b.tar"
    write_backup(store, backup)
    data = bytearray(backup.read_bytes())
    at = data.index(b'"Couch"')
    data[at + 1 : at + 3] = b"ab"  # more than one bit, which would be put right
    backup.write_bytes(data)
    other = MapStore(tmp_path / "other")
    report = restore_backup(other, backup)
    assert len(report.damaged) == 1 and report.versions == 2
    assert other.load(place_map.id).places[0].name == "Sofa"
    backup.write_bytes(b"nothing" * 1000)
    with pytest.raises(DataError, match="no backup"):
        restore_backup(other, backup)


def test_a_backup_without_a_map_or_an_end_is_told(store: MapStore, tmp_path: Path) -> None:
    backup = tmp_path / "b.tar"
    write_backup(store, backup)
    whole = backup.read_bytes()
    with tarfile.open(backup, "w") as archive:
        archive.addfile(tarfile.TarInfo("notes.txt"))
    with pytest.raises(DataError, match="no map in it"):
        restore_backup(MapStore(tmp_path / "other"), backup)
    backup.write_bytes(whole[: len(whole.rstrip(b"\0")) // 512 * 512 + 512])  # cut behind the last member
    report = restore_backup(MapStore(tmp_path / "cut"), backup)
    assert report.versions == 3 and any("end" in sentence for sentence in report.damaged)


def test_purging_frees_the_space_of_a_deleted_map(
    place_map: PlaceMap, store: MapStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("station.maps.repair.purging.UNUSED_S", -1.0)
    purge_versions(store.for_writing(), place_map.id)
    assert [r.number for r in store.history(place_map.id)] == [3]
    assert store.load(place_map.id).places[0].name == "Couch"
    store.delete(place_map.id)
    purge_versions(store.for_writing(), place_map.id)
    assert list(blobs(store)) == [] and store.list() == ()
    with pytest.raises(DataError, match="holds no map"):
        store.undo(place_map.id)
    assert MapStore(store.address).list() == ()
    store.save(replace(place_map, name="again"))
    assert store.load(place_map.id).name == "again" and verify(store) == ()


def test_the_commands_say_what_they_do(place_map: PlaceMap, tmp_path: Path) -> None:
    def run(*words: str, code: int = 0) -> str:
        result = CliRunner().invoke(app, ["map", *words, "--data", str(tmp_path)])
        assert result.exit_code == code, result.output
        return result.output

    assert "which is not there" in run("list")
    store = MapStore(tmp_path / "maps")
    store.save(place_map)
    rename_place(store, place_map.id, place_map.places[0].id, "Sofa")
    assert place_map.id in run("list") and "Sofa" in run("show", place_map.id)
    assert "is now Sofa" in run("history", place_map.id)
    assert "version 1 again" in run("undo", place_map.id)
    run("backup", str(tmp_path / "b.tar"))
    run("delete", place_map.id)
    assert f"`station map undo {place_map.id} --data {tmp_path}` brings it back" in run("list")
    run("undo", place_map.id)
    assert "all maps are as they were written" in run("verify")
    cut(largest_blob(store))
    assert "is damaged" in run("verify", code=1)
    assert "not repaired" in run("repair", code=1)
    assert "1 maps read" in run("restore", str(tmp_path / "b.tar"))
    assert "all maps are as they were written" in run("verify")


def test_a_restore_into_another_folder_says_what_is_to_be_done_then(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(tmp_path / "maps")
    store.save(place_map)
    write_backup(store, tmp_path / "b.tar")
    restore = ["map", "restore", str(tmp_path / "b.tar"), "--data", str(tmp_path / "other")]
    assert "PUT /maps/active" in CliRunner().invoke(app, restore).output
    assert "0 versions added\n" in CliRunner().invoke(app, restore).output[-20:]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("deep.000001", b"[" * 100_000),
        ("noise.000001", b"\xff\x00"),
        ("newer.000001", b'{"format": 99}'),
        ("path.000001", b'{"format": 2, "map_id": "../../outside"}'),
    ],
)
def test_a_record_of_a_backup_that_cannot_be_read_costs_no_other(
    name: str, content: bytes, place_map: PlaceMap, store: MapStore, tmp_path: Path
) -> None:
    write_backup(store, tmp_path / "whole.tar")
    backup = backup_with_records(tmp_path / "b.tar", tmp_path / "whole.tar", (name, content))
    other = MapStore(tmp_path / "other")
    report = restore_backup(other, backup)
    assert report.versions == 3 and other.load(place_map.id).places[0].name == "Couch"
    assert len(report.damaged) == 1 and f"records/{name}" in report.damaged[0]


@pytest.mark.parametrize("change", [{"map_id": "../../outside"}, {"number": 7}, {"name": 3}, {"places": [{"id": "a"}]}])
def test_a_record_that_is_not_what_its_name_says_is_left_out(
    change: dict[str, Any], place_map: PlaceMap, store: MapStore, tmp_path: Path
) -> None:
    write_backup(store, tmp_path / "whole.tar")
    content = json.loads(encode_record(store.history(place_map.id)[-1])) | change
    backup = backup_with_records(
        tmp_path / "b.tar", tmp_path / "whole.tar", ("another.000001", json.dumps(content).encode())
    )
    other = MapStore(tmp_path / "other")
    report = restore_backup(other, backup)
    assert report.maps == 1 and len(report.damaged) == 1 and "records/another" in report.damaged[0]


@pytest.mark.parametrize("number", [math.nan, math.inf])
@pytest.mark.parametrize("key", ["centroid_map", "radius"])
def test_a_place_that_is_nowhere_is_refused(key: str, number: float, place_map: PlaceMap, store: MapStore) -> None:
    content = json.loads(encode_record(store.history(place_map.id)[0]))
    content["places"][0][key] = [0.0, number, 0.0] if key == "centroid_map" else number
    with pytest.raises(DataError, match="not finite"):
        decode_record(json.dumps(content).encode(), "it")
