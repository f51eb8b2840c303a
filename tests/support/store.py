"""What tests do with map stores, and harm for those in folders."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

from station.files.navigation_folder import REPORT
from station.maps.address import address_of
from station.maps.blobs import blob_name
from station.maps.editing import with_place_renamed
from station.maps.record import content_hash as hash_of_record
from station.maps.repair.purging import UNUSED_S
from station.maps.store import MapStore
from station.model.place_map import PlaceMap
from station.places.rooms.edits import with_room_renamed


def rename_place(store: MapStore, map_id: str, place_id: str, name: str) -> PlaceMap:
    """Give a place another name, and return the map."""
    why = f"{place_id} is now {name.strip()}"
    return store.edit(map_id, lambda place_map: with_place_renamed(place_map, place_id, name), why)[0]


def rename_room(store: MapStore, map_id: str, room_id: str, name: str) -> PlaceMap:
    """Give a room a name, and return the map."""
    why = f"{room_id} is now {name}"
    return store.edit(map_id, lambda place_map: with_room_renamed(place_map, room_id, name), why)[0]


def content_hash(store: MapStore, map_id: str) -> str:
    """What the newest version is, whoever made it and when."""
    record = store.history(map_id)[0]
    report = store.contents.blobs.get(record.files[REPORT].address, f"map {map_id}: {REPORT}")
    return hash_of_record(record, report)


def blobs(store: MapStore) -> Iterator[Path]:
    return (p for p in sorted((store.address.root / "blobs").rglob("*")) if p.is_file())


def leave_old_blob(root: Path) -> Path:
    """As a build does that was killed two days ago."""
    address = address_of(b"of a map that was never written")
    path = root / blob_name(address)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"of a map that was never written")
    os.utime(path, (time.time() - 2 * UNUSED_S,) * 2)
    return path


def largest_blob(store: MapStore) -> Path:
    return max(blobs(store), key=lambda path: path.stat().st_size)


def newest_record(store: MapStore) -> Path:
    return max((store.address.root / "records").iterdir())


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])
