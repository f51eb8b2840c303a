"""Deleted maps, gone for good."""

from __future__ import annotations

from shared.errors import DataError
from station.maps import versions
from station.maps.record import FOLDER
from station.maps.repair.unclaimed import ASIDE, RecordFile, record_files
from station.maps.store import MapStore


def purge(store: MapStore, map_id: str) -> None:
    """Forget every version of a deleted map; nothing happens where there is none. Its files go with the next tidying.

    Rows go first and records after them, the oldest first: whoever is killed in between leaves a map that is deleted.

    Raises:
        DataError: the map was not deleted, or the store cannot be written.
    """
    store.open(writes=True)
    with store.database.writing(map_id) as connection:
        rows = versions.history(connection, map_id)
        if not rows:
            return
        if rows[0].kind != "deleted":
            raise DataError(f"map {map_id} is not deleted; delete it first")
        files = records_of(store, map_id)  # now, as no other writer can make one of a new map of this id
        versions.forget(connection, map_id, below=rows[0].number + 1)
    for file in files:
        store.bucket.remove(file.name)


def records_of(store: MapStore, map_id: str) -> list[RecordFile]:
    """Every record of a map, the oldest first: also lost ones, which no row names."""
    found = [file for folder in (FOLDER, ASIDE) for file in record_files(store, folder) if file.map_id == map_id]
    return sorted(found, key=lambda file: file.number)
