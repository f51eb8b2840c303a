"""Deleted maps, gone for good."""

from __future__ import annotations

from shared.errors import DataError
from station.maps import versions
from station.maps.record import FOLDER, parse_record_name
from station.maps.store import MapStore

ASIDE = "damaged"  # the folder of records that are lost


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
        names = _records(store, map_id)  # now, as no other writer can make one of a new map of this id
        versions.forget(connection, map_id, below=rows[0].number + 1)
    for name in names:
        store.bucket.remove(name)


def _records(store: MapStore, map_id: str) -> list[str]:
    """Every record of a map, the oldest first: also lost ones, which no row names."""
    found = []
    for folder in (FOLDER, ASIDE):
        for name, _ in store.bucket.names(folder):
            parsed = parse_record_name(f"{FOLDER}/{name.removeprefix(f'{folder}/')}")
            if parsed is not None and parsed[0] == map_id:
                found.append((parsed[1], name))
    return [name for _, name in sorted(found)]
