"""Backups in which something is damaged: what it leads to may be lost, and is told; nothing else is."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from shared.errors import DataError
from station.maps.backup import README, README_BEFORE_LISTS, README_NAME, BackupReport, restore_backup, write_backup
from station.maps.record_files import parse_record_name
from station.maps.store import MapStore
from station.model.place_map import PlaceMap
from tests.support.store import rename_place

Harm = Callable[[bytes, int], bytes]


@pytest.fixture
def store(place_map: PlaceMap, tmp_path: Path) -> MapStore:
    """A map of three versions."""
    store = MapStore(tmp_path / "maps")
    store.save(place_map)
    for name in ("Sofa", "Couch"):
        rename_place(store, place_map.id, place_map.places[0].id, name)
    return store


@pytest.fixture
def whole(store: MapStore, tmp_path: Path) -> bytes:
    write_backup(store, tmp_path / "whole.tar")
    return (tmp_path / "whole.tar").read_bytes()


def members_of(data: bytes) -> list[tarfile.TarInfo]:
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        return archive.getmembers()


class Restored:
    """What a new store has and says after this backup."""

    def __init__(self, folder: Path, data: bytes) -> None:
        folder.mkdir()
        (folder / "b.tar").write_bytes(data)
        self.told: list[str] = []
        store = MapStore(folder / "maps", self.told.append)
        self.report: BackupReport = restore_backup(store, folder / "b.tar")
        self.versions = {record.number for one in store.list() for record in store.history(one.id)}

    @property
    def damaged(self) -> str:
        return "; ".join(self.report.damaged)


def two_wrong_bits(data: bytes, at: int) -> bytes:
    """In one header: of its name, and of what every header has."""
    wrong = bytearray(data)
    wrong[at + 10] ^= 4
    wrong[at + 257] ^= 1
    return bytes(wrong)


def lost_sector(data: bytes, at: int) -> bytes:
    return data[:at] + bytes(512) + data[at + 512 :]


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]


@pytest.mark.parametrize("harm", [two_wrong_bits, lost_sector])
def test_a_lost_header_costs_nothing_where_the_list_is_sound(whole: bytes, tmp_path: Path, harm: Harm) -> None:
    for number, member in enumerate(members_of(whole)[:-1]):
        restored = Restored(tmp_path / f"{number}", harm(whole, member.offset_data - 512))
        assert restored.versions == {1, 2, 3}, member.name
        if member.name == README_NAME:
            assert "1024 bytes before records" in restored.damaged
        else:
            assert restored.damaged == "", member.name
            assert len(restored.told) == 1 and member.name[:40] in restored.told[0]


@pytest.mark.parametrize("harm", [two_wrong_bits, lost_sector])
def test_without_a_list_a_lost_header_costs_what_it_leads_to(
    store: MapStore, place_map: PlaceMap, whole: bytes, tmp_path: Path, harm: Harm
) -> None:
    history = store.history(place_map.id)
    needed_by = {record.number: {ref.address for ref in record.files.values()} for record in history}
    *members, last = members_of(whole)
    without_list = lost_sector(whole, last.offset)
    for number, member in enumerate(members):
        restored = Restored(tmp_path / f"{number}", harm(without_list, member.offset_data - 512))
        assert "bytes before" in restored.damaged or "bytes at its end" in restored.damaged, member.name
        assert "its list is missing" in restored.damaged
        if record := parse_record_name(member.name):
            assert restored.versions == {1, 2, 3} - {record.number}
        else:
            address = member.name.rpartition("/")[2]
            assert restored.versions == {n for n, needed in needed_by.items() if address not in needed}, member.name


@pytest.mark.parametrize("block", [0, 1, 2])
def test_the_header_of_a_long_name_costs_its_file_alone_wherever_it_is_wrong(
    whole: bytes, tmp_path: Path, block: int
) -> None:
    first, *others, last = members_of(whole)[1:]
    assert others and first.offset_data - first.offset == 3 * 512
    # Also where it is the archive's first one: nothing before it was read.
    for name, begin in (("first", first.offset), ("second", 0)):
        data = lost_sector(lost_sector(whole, last.offset), first.offset + block * 512)[begin:]
        assert Restored(tmp_path / name, data).versions == {2, 3}


def test_a_header_that_leads_out_of_the_archive_costs_its_file_alone(
    store: MapStore, whole: bytes, tmp_path: Path
) -> None:
    member = members_of(whole)[1]
    for number, size in enumerate((-1024, 8 * len(whole))):
        header = tarfile.TarInfo(member.name[:90])
        header.size = size
        data = whole[: member.offset] + header.tobuf(tarfile.GNU_FORMAT)[:512] + whole[member.offset + 512 :]
        data = lost_sector(data, members_of(whole)[-1].offset)
        assert Restored(tmp_path / f"{number}", data).versions == {2, 3}


def test_a_file_of_nothing_but_broken_headers_is_no_backup(tmp_path: Path) -> None:
    header = tarfile.TarInfo("././@PaxHeader")
    header.type, header.size = tarfile.XHDTYPE, 512
    (tmp_path / "b.tar").write_bytes(header.tobuf(tarfile.USTAR_FORMAT) * 300)
    with pytest.raises(DataError, match=r"no backup .*more than 100 headers"):
        restore_backup(MapStore(tmp_path / "other"), tmp_path / "b.tar")


def test_one_wrong_bit_behind_the_last_file_is_nothing(whole: bytes, tmp_path: Path) -> None:
    last = members_of(whole)[-1]
    end = last.offset_data + -(-last.size // 512) * 512
    for number, at in enumerate((end, end + 700, len(whole) - 1)):
        restored = Restored(tmp_path / f"{number}", flipped(whole, at))
        assert restored.report.damaged == () and restored.versions == {1, 2, 3}
    restored = Restored(tmp_path / "two", flipped(flipped(whole, end), end + 100))
    assert f"{len(whole) - end} bytes at its end" in restored.damaged and restored.versions == {1, 2, 3}


def backup_before_lists(whole: bytes, readme: bytes) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=io.BytesIO(whole)) as archive, tarfile.open(fileobj=out, mode="w") as old:
        member = tarfile.TarInfo(README_NAME)
        member.size = len(readme)
        old.addfile(member, io.BytesIO(readme))
        for member in archive.getmembers()[1:-1]:
            old.addfile(member, archive.extractfile(member))
    return out.getvalue()


def test_one_wrong_bit_of_what_a_backup_from_before_lists_begins_with_is_nothing(whole: bytes, tmp_path: Path) -> None:
    for number, readme in enumerate((README_BEFORE_LISTS, flipped(README_BEFORE_LISTS, 20))):
        assert Restored(tmp_path / f"{number}", backup_before_lists(whole, readme)).report.damaged == ()
    for number, readme in enumerate((README, flipped(flipped(README_BEFORE_LISTS, 20), 30))):
        assert "its list is missing" in Restored(tmp_path / f"x{number}", backup_before_lists(whole, readme)).damaged


def test_a_missing_list_is_told_whatever_else_is_damaged(whole: bytes, tmp_path: Path) -> None:
    _, *others, last = members_of(whole)
    blob = others[-1]
    damaged = flipped(flipped(whole, blob.offset_data), blob.offset_data + 1)
    restored = Restored(tmp_path / "list", lost_sector(damaged, last.offset))
    assert "is damaged" in restored.damaged and "its list is missing" in restored.damaged
    # What follows from the missing end is not told twice, nor what was told of a list that is there.
    restored = Restored(tmp_path / "end", whole[: blob.offset])
    assert "ends early" in restored.damaged and "its list is missing" not in restored.damaged
    restored = Restored(tmp_path / "damaged", flipped(flipped(whole, last.offset_data), last.offset_data + 1))
    assert "its list is damaged" in restored.damaged and "its list is missing" not in restored.damaged
