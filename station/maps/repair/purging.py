"""Deleted maps and earlier versions, gone for good, and the files that nothing needs any more."""

from __future__ import annotations

from shared.disk import SCRATCH
from shared.errors import DataError
from station.maps import versions
from station.maps.blobs import Damaged
from station.maps.contents import Contents
from station.maps.record_files import ASIDE, FOLDER, RecordFile, record_files
from station.maps.store import MapStore
from station.maps.unclaimed import read_all, without_row

UNUSED_S = 24 * 3600.0  # blobs nobody names are kept as long: their map may be being saved


def purge(contents: Contents, map_id: str) -> None:
    """Forget every version of a deleted map; nothing happens where there is none. Its files go with the next tidying.

    Rows go first and records after them, the oldest first: whoever is killed in between leaves a map that is deleted.

    Raises:
        DataError: the map was not deleted, or the store cannot be written.
    """
    with contents.database.writing(map_id) as connection:
        rows = versions.history(connection, map_id)
        if not rows:
            return
        if rows[0].kind != "deleted":
            raise DataError(f"map {map_id} is not deleted; delete it first")
        files = records_of(contents, map_id)  # now, as no other writer can make one of a new map of this id
        versions.forget(connection, map_id, below=rows[0].number + 1)
    for file in files:
        contents.bucket.remove(file.name)


def collect_garbage(contents: Contents) -> list[str]:
    """Remove files that no record needs: of purged maps, and of writers that were killed. What was done, in sentences.

    Nothing while somebody writes a map: a clock that is set makes its files as old as those nobody needs.
    """
    with contents.bucket.tidying() as is_alone:
        if not is_alone:
            return ["nothing was tidied up: a map is being written"]
        return _collect_garbage(contents)


def tidy_up(store: MapStore) -> None:
    """Remove what builds left that were killed, unasked: not in an index that several stations share.

    There files' ages alone tell whose map is being written, and a clock may be wrong. Raises DataError.
    """
    if store.open() and store.contents.database.is_sqlite:
        collect_garbage(store.contents)


def _collect_garbage(contents: Contents) -> list[str]:
    for file in record_files(contents.bucket, ASIDE):
        where = f"{contents.bucket.place}/{file.name}"
        return [f"nothing was tidied up: {where} may still need its files; purging map {file.map_id} lets it go"]
    with contents.database.reading() as connection:
        rows = versions.all_rows(connection)
    needed: set[str] = set()
    try:
        for row in rows:
            needed |= {ref.address for ref in contents.record(row).files.values()}
    except Damaged:
        return ["nothing was tidied up: a damaged version may still need its files"]
    # Those without a row, too: the index may be of another store, or another station may be about to commit.
    for one in read_all(contents.bucket, without_row(contents.bucket, rows), contents.notify):
        if one.record is None:
            return [f"nothing was tidied up: {one.sentence.partition(';')[0]}, and may still need its files"]
        needed |= {ref.address for ref in one.record.files.values()}
    unused = [address for address, age_s in contents.blobs.addresses() if address not in needed and age_s > UNUSED_S]
    parts = [
        name
        for folder in (FOLDER, ASIDE, "blobs")
        for name, age_s in contents.bucket.names(folder)
        if name.rpartition("/")[2].startswith(SCRATCH) and age_s > UNUSED_S
    ]
    removed = [address for address in unused if contents.blobs.remove(address, UNUSED_S)]
    for name in parts:
        contents.bucket.remove(name)
    count = len(removed) + len(parts)
    return [f"{count} unused files were removed"] if count else []


def purge_versions(contents: Contents, map_id: str) -> list[str]:
    """Forget the earlier versions of a map; all of it, without way back, where it was deleted or lost.

    Returns what was done, in sentences.
    Raises:
        DataError: there is no such map.
    """
    with contents.database.writing(map_id) as connection:
        rows = versions.history(connection, map_id)
        files = records_of(contents, map_id)
        if not rows and not files:
            raise contents.no_map(map_id)
        is_kept = bool(rows) and rows[0].kind != "deleted"
        if is_kept:
            files = [file for file in files if file.number < rows[0].number or file.folder == ASIDE]
            versions.forget(connection, map_id, below=rows[0].number)
    if not is_kept and rows:
        purge(contents, map_id)
    else:
        for file in files:  # after the commit: without row and older than the newest they never count
            contents.bucket.remove(file.name)
    return [
        f"the earlier versions of {map_id} are gone" if is_kept else f"{map_id} is gone",
        *collect_garbage(contents),
    ]


def records_of(contents: Contents, map_id: str) -> list[RecordFile]:
    """Every record of a map, the oldest first: also lost ones, which no row names."""
    everything = (file for folder in (FOLDER, ASIDE) for file in record_files(contents.bucket, folder))
    return sorted((file for file in everything if file.map_id == map_id), key=lambda file: file.number)
