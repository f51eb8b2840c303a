"""Looks at every byte of a map store, and puts right what can be: from checksums, from copies, from older versions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from shared.bounded import MAX_FILE_BYTES, read_file
from station.maps import opening, versions
from station.maps.address import is_whole
from station.maps.blobs import Damaged, blob_name, read_checked
from station.maps.bucket import Unreadable
from station.maps.contents import Contents, row_of
from station.maps.record import MapRecord, decode_record
from station.maps.record_files import ASIDE, FOLDER, RecordFile, record_files
from station.maps.repair.purging import collect_garbage
from station.maps.store import MapStore
from station.maps.unclaimed import newer, read_all, without_row
from station.maps.versions import VersionRow


@dataclass(frozen=True, slots=True)
class Damage:
    """Something that is not what was written."""

    map_id: str
    number: int  # of the version
    address: str  # of the blob; empty: the version's row or record
    size: int  # of the blob, bytes
    sentence: str


def verify(store: MapStore) -> tuple[Damage, ...]:
    """What is damaged and could not be put right by itself; the store's `notify` hears what could."""
    if not store.open():
        return ()
    with store.reading() as connection:
        rows = versions.all_rows(connection)
    return (*_damages(store.contents, rows), *_lost(store.contents, rows))


@dataclass(frozen=True, slots=True)
class Repair:
    """What repairing did, in sentences."""

    done: tuple[str, ...]
    left: tuple[Damage, ...]  # what stays damaged


def repair(store: MapStore, copies: Iterable[Path] = ()) -> Repair:
    """Put right what can be.

    Args:
        copies: folders that may hold the same files under whatever name, such as the navigations maps were made from.
    """
    contents = store.for_writing()
    folders = list(copies)
    done = _index_unclaimed(contents) + _repair_rows(contents)
    done += _copy_records(contents, folders)
    done += _index_unclaimed(contents)
    damages = verify(store)
    wanted = {damage.address: damage for damage in damages if damage.address}
    for address, data, path in _found_copies(wanted, folders):
        contents.bucket.put({blob_name(address): data})
        done.append(f"{wanted[address].sentence.partition(';')[0]}: copied again from {path}")
    done += _index_unclaimed(contents)
    done += _set_aside(contents)
    left = verify(store) if done else damages
    done += _go_back(store, contents, left)
    done += collect_garbage(contents)
    return Repair(tuple(done), left)


def _index_unclaimed(contents: Contents) -> list[str]:
    return [f"version {row.number} of map {row.map_id} was taken in" for row in opening.index_unclaimed(contents)]


def _damages(contents: Contents, rows: list[VersionRow]) -> Iterator[Damage]:
    seen: set[str] = set()  # addresses looked at: versions share most of their files
    for row in rows:
        try:
            record = contents.record(row)
        except Damaged as exc:
            yield Damage(row.map_id, row.number, "", 0, str(exc))
            continue
        yield from _missing(contents, record, seen)


def _lost(contents: Contents, rows: list[VersionRow]) -> Iterator[Damage]:
    """Of what was lost together with the index, which would have told of it. As index_unclaimed, SQLite only."""
    if not contents.database.is_sqlite:
        return
    files = without_row(contents.bucket, rows)
    may_count = {file.name for file in newer(files, rows)}
    for one in read_all(contents.bucket, files, contents.notify):
        if one.record is None:
            yield Damage(one.file.map_id, one.file.number, "", 0, one.sentence)
        elif one.file.name in may_count:
            yield from _missing(contents, one.record, set())


def _missing(contents: Contents, record: MapRecord, seen: set[str]) -> Iterator[Damage]:
    for name, ref in record.files.items():
        if ref.address in seen:
            continue
        seen.add(ref.address)
        try:
            contents.blobs.get(ref.address, f"map {record.map_id}, version {record.number}: {name}")
        except Damaged as exc:
            yield Damage(record.map_id, record.number, ref.address, ref.size, str(exc))


def _copy_records(contents: Contents, folders: list[Path]) -> list[str]:
    """Records that are damaged, from copies: the name of a record's file says what it holds."""
    with contents.database.reading() as connection:
        rows = versions.all_rows(connection)
    wanted: dict[str, RecordFile] = {}
    for file in record_files(contents.bucket):
        if not _is_whole_or_gone(contents, file):
            wanted[file.name.rpartition("/")[2]] = file
    names = {file.name for file in record_files(contents.bucket)}
    for row in rows:
        if row.file.name not in names:
            wanted[row.file.name.rpartition("/")[2]] = row.file
    done = []
    for folder in folders if wanted else ():
        for path in sorted(path for path in folder.rglob("*") if path.name in wanted and path.is_file()):
            file = wanted[path.name]
            data = _read(path)
            if data is not None and is_whole(data, file.address):
                contents.bucket.put({file.name: data})
                done.append(f"the record of version {file.number} of map {file.map_id} was copied again from {path}")
                del wanted[path.name]
    return done


def _is_whole_or_gone(contents: Contents, file: RecordFile) -> bool:
    try:
        data = contents.bucket.get(file.name)
    except Unreadable:
        return False
    return data is None or is_whole(data, file.address)


def _set_aside(contents: Contents) -> list[str]:
    """Records that are lost, kept beside the others for whoever can read more out of them."""
    if not contents.database.is_sqlite:
        return []  # another station may be about to commit one
    done = []
    with contents.database.writing(FOLDER) as connection:
        rows = versions.all_rows(connection)
        for one in read_all(contents.bucket, without_row(contents.bucket, rows), contents.notify):
            if one.record is not None or one.data is None:  # what cannot be read cannot be moved
                continue
            file = one.file
            aside = replace(file, folder=ASIDE).name
            contents.bucket.put({aside: one.data})
            contents.bucket.remove(file.name)
            of_map = [row for row in rows if row.map_id == file.map_id]
            newest = max(of_map, key=lambda row: row.number, default=None)
            left = f"it is what it was at version {newest.number}" if newest else "nothing else of it is there"
            if newest is not None and newest.kind == "deleted":
                left += f", deleted: `station map undo {file.map_id}` brings it back"
            where = f"{contents.bucket.place}/{aside}"
            done.append(f"version {file.number} of map {file.map_id} is lost (its record is {where} now); {left}")
    return done


def _repair_rows(contents: Contents) -> list[str]:
    """Rows made again from their records (a PostgreSQL row; SQLite's file is made again as a whole)."""
    with contents.database.reading() as connection:
        broken = [row for row in versions.all_rows(connection) if not row.is_sealed]
    done = []
    for row in broken:
        for file in record_files(contents.bucket):
            if (file.map_id, file.number) != (row.map_id, row.number):
                continue
            try:
                data = read_checked(contents.bucket, file.name, file.address, file.name, contents.notify)
            except Damaged:
                continue
            with contents.database.writing(row.map_id) as connection:
                versions.replace_row(connection, row_of(decode_record(data, file.name), data))
            done.append(f"the row of version {row.number} of map {row.map_id} was made again from its record")
    return done


def _found_copies(wanted: dict[str, Damage], folders: Iterable[Path]) -> Iterator[tuple[str, bytes, Path]]:
    sizes = {damage.size for damage in wanted.values()}
    missing = set(wanted)
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if missing and path.is_file() and path.stat().st_size in sizes:
                data = _read(path) or b""
                for address in [a for a in missing if wanted[a].size == len(data) and is_whole(data, a)]:
                    missing.discard(address)
                    yield address, data, path


def _read(path: Path) -> bytes | None:
    """Of a folder with copies; None where a file of it cannot be read, which need not be the one that is sought."""
    try:
        return read_file(path, MAX_FILE_BYTES)
    except OSError:
        return None


def _go_back(store: MapStore, contents: Contents, left: tuple[Damage, ...]) -> list[str]:
    """Maps whose newest version is lost open at their last good one; make that the newest."""
    done = []
    bad_records = {(damage.map_id, damage.number) for damage in left if not damage.address}
    bad_blobs = {damage.address for damage in left if damage.address}
    for map_id in sorted({damage.map_id for damage in left}):
        with contents.database.reading() as connection:
            rows = versions.history(connection, map_id)
        good = next((row for row in rows if _is_good(contents, row, bad_records, bad_blobs)), None)
        if good is not None and good is not rows[0] and good.kind != "deleted":
            store.undo(map_id, to=good.number)
            done.append(f"map {map_id} is again what it was at version {good.number}")
    return done


def _is_good(contents: Contents, row: VersionRow, bad_records: set[tuple[str, int]], bad_blobs: set[str]) -> bool:
    if (row.map_id, row.number) in bad_records:
        return False
    record: MapRecord = contents.record(row)
    return not bad_blobs & {ref.address for ref in record.files.values()}
