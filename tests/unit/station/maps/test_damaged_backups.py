"""Backups in which something is damaged: what it leads to may be lost, and is told; nothing else is."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from station.maps.backup import README_NAME, BackupReport, restore_backup, write_backup
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
