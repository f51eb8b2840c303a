"""Looks at every byte of a map store, and puts right what can be: from checksums, from copies, from older versions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from shared.disk import SCRATCH
from station.maps import versions
from station.maps.address import is_whole
from station.maps.blobs import Damaged, blob_name
from station.maps.record import FOLDER, MapRecord, decode_record, parse_record_name
from station.maps.repair import opening
from station.maps.repair.purging import purge, records_of
from station.maps.repair.unclaimed import ASIDE, RecordFile, newer, read_all, record_files, without_row
from station.maps.store import MapStore
from station.maps.versions import VersionRow, row_of

UNUSED_S = 24 * 3600.0  # blobs nobody names are kept as long: their map may be being saved


@dataclass(frozen=True, slots=True)
class Damage:
    """Something that is not what was written."""

    map_id: str
    number: int  # of the version
    address: str  # of the blob; empty: the version's row or record
    size: int  # of the blob, bytes
    sentence: str


def verify(store: MapStore) -> tuple[Damage, ...]:
    """What is damaged and could not be put right by itself; the store's `tell` hears what could."""
    if not store.open():
        return ()
    with store.reading() as connection:
        rows = versions.all_rows(connection)
    return (*_damages(store, rows), *_lost(store, rows))


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
    if not store.open(writes=True):
        return Repair((), ())
    folders = list(copies)
    done = _take_in(store) + _repair_rows(store)
    done += _copy_records(store, folders)
    done += _take_in(store)
    damages = verify(store)
    wanted = {damage.address: damage for damage in damages if damage.address}
    for address, path in _found_copies(wanted, folders):
        store.bucket.put({blob_name(address): path.read_bytes()})
        done.append(f"{wanted[address].sentence.partition(';')[0]}: copied again from {path}")
    done += _take_in(store)
    done += _set_aside(store)
    left = verify(store) if done else damages
    done += _go_back(store, left)
    done += collect_garbage(store)
    return Repair(tuple(done), left)


def _take_in(store: MapStore) -> list[str]:
    return [f"version {row.number} of map {row.map_id} was taken in" for row in opening.take_in_records(store)]


def collect_garbage(store: MapStore) -> list[str]:
    """Remove files that no record needs: of purged maps, and of writers that were killed."""
    for file in record_files(store, ASIDE):
        where = f"{store.bucket.place}/{file.name}"
        return [f"nothing was tidied up: {where} may still need its files; purging map {file.map_id} lets it go"]
    with store.reading() as connection:
        rows = versions.all_rows(connection)
    needed: set[str] = set()
    try:
        for row in rows:
            needed |= {ref.address for ref in store.record(row).files.values()}
    except Damaged:
        return ["nothing was tidied up: a damaged version may still need its files"]
    # Those without a row, too: the index may be of another store, or another station may be about to commit.
    for one in read_all(store, without_row(store, rows)):
        if one.record is None:
            return [f"nothing was tidied up: {one.sentence.partition(';')[0]}, and may still need its files"]
        needed |= {ref.address for ref in one.record.files.values()}
    unused = [address for address, age_s in store.blobs.addresses() if address not in needed and age_s > UNUSED_S]
    parts = [
        name
        for folder in (FOLDER, ASIDE, "blobs")
        for name, age_s in store.bucket.names(folder)
        if name.rpartition("/")[2].startswith(SCRATCH) and age_s > UNUSED_S
    ]
    removed = [address for address in unused if store.blobs.remove(address, UNUSED_S)]
    for name in parts:
        store.bucket.remove(name)
    count = len(removed) + len(parts)
    return [f"{count} unused files were removed"] if count else []


def purge_versions(store: MapStore, map_id: str) -> list[str]:
    """Forget the earlier versions of a map; all of it, without way back, where it was deleted or lost.

    Returns what was done, in sentences.
    Raises:
        DataError: there is no such map.
    """
    store.open(writes=True)
    with store.database.writing(map_id) as connection:
        rows = versions.history(connection, map_id)
        files = records_of(store, map_id)
        if not rows and not files:
            raise store.no_map(map_id)
        is_kept = bool(rows) and rows[0].kind != "deleted"
        if is_kept:
            files = [file for file in files if file.number < rows[0].number or file.name.startswith(f"{ASIDE}/")]
            versions.forget(connection, map_id, below=rows[0].number)
    if not is_kept and rows:
        purge(store, map_id)
    else:
        for file in files:  # after the commit: without row and older than the newest they never count
            store.bucket.remove(file.name)
    return [f"the earlier versions of {map_id} are gone" if is_kept else f"{map_id} is gone", *collect_garbage(store)]


def _damages(store: MapStore, rows: list[VersionRow]) -> Iterator[Damage]:
    seen: set[str] = set()  # addresses looked at: versions share most of their files
    for row in rows:
        try:
            record = store.record(row)
        except Damaged as exc:
            yield Damage(row.map_id, row.number, "", 0, str(exc))
            continue
        for name, ref in record.files.items():
            if ref.address in seen:
                continue
            seen.add(ref.address)
            try:
                store.blobs.get(ref.address, f"map {row.map_id}, version {row.number}: {name}")
            except Damaged as exc:
                yield Damage(row.map_id, row.number, ref.address, ref.size, str(exc))


def _lost(store: MapStore, rows: list[VersionRow]) -> Iterator[Damage]:
    """Of what was lost together with the index, which would have told of it. As take_in_records, SQLite only."""
    if not store.database.is_sqlite:
        return
    files = without_row(store, rows)
    may_count = {file.name for file in newer(files, rows)}
    for one in read_all(store, files):
        if one.record is None:
            yield Damage(one.file.map_id, one.file.number, "", 0, one.sentence)
        elif one.file.name in may_count:
            yield from _missing(store, one.record)


def _missing(store: MapStore, record: MapRecord) -> Iterator[Damage]:
    for name, ref in record.files.items():
        try:
            store.blobs.get(ref.address, f"map {record.map_id}, version {record.number}: {name}")
        except Damaged as exc:
            yield Damage(record.map_id, record.number, ref.address, ref.size, str(exc))


def _copy_records(store: MapStore, folders: list[Path]) -> list[str]:
    """Records that are damaged, from copies: the name of a record's file says what it holds."""
    with store.reading() as connection:
        rows = versions.all_rows(connection)
    wanted: dict[str, RecordFile] = {}
    for file in record_files(store):
        data = store.bucket.get(file.name)
        if data is not None and not is_whole(data, file.address):
            wanted[file.name.rpartition("/")[2]] = file
    for row in rows:
        if store.bucket.get(row.record_name) is None:
            name = row.record_name
            wanted[name.rpartition("/")[2]] = RecordFile(row.map_id, row.number, row.record, name)
    done = []
    for folder in folders if wanted else ():
        for path in sorted(path for path in folder.rglob("*") if path.name in wanted and path.is_file()):
            file = wanted[path.name]
            data = path.read_bytes()
            if is_whole(data, file.address):
                store.bucket.put({file.name: data})
                done.append(f"the record of version {file.number} of map {file.map_id} was copied again from {path}")
                del wanted[path.name]
    return done


def _set_aside(store: MapStore) -> list[str]:
    """Records that are lost, kept beside the others for whoever can read more out of them."""
    if not store.database.is_sqlite:
        return []  # another station may be about to commit one
    done = []
    with store.database.writing(FOLDER) as connection:
        rows = versions.all_rows(connection)
        for one in read_all(store, without_row(store, rows)):
            if one.record is not None:
                continue
            file = one.file
            aside = f"{ASIDE}/{file.name.removeprefix(f'{FOLDER}/')}"
            store.bucket.put({aside: one.data})
            store.bucket.remove(file.name)
            of_map = [row for row in rows if row.map_id == file.map_id]
            newest = max(of_map, key=lambda row: row.number, default=None)
            left = f"it is what it was at version {newest.number}" if newest else "nothing else of it is there"
            if newest is not None and newest.kind == "deleted":
                left += f", deleted: `station map undo {file.map_id}` brings it back"
            where = f"{store.bucket.place}/{aside}"
            done.append(f"version {file.number} of map {file.map_id} is lost (its record is {where} now); {left}")
    return done


def _repair_rows(store: MapStore) -> list[str]:
    """Rows made again from their records (a PostgreSQL row; SQLite's file is made again as a whole)."""
    with store.reading() as connection:
        broken = [row for row in versions.all_rows(connection) if not row.is_sealed]
    done = []
    for row in broken:
        for name, _ in store.bucket.names(FOLDER):
            parsed = parse_record_name(name)
            if parsed is None or parsed[:2] != (row.map_id, row.number):
                continue
            data = store.bucket.get(name)
            if data is None or not is_whole(data, parsed[2]):
                continue
            with store.database.writing(row.map_id) as connection:
                versions.replace_row(connection, row_of(decode_record(data, name), data))
            done.append(f"the row of version {row.number} of map {row.map_id} was made again from its record")
    return done


def _found_copies(wanted: dict[str, Damage], folders: Iterable[Path]) -> Iterator[tuple[str, Path]]:
    sizes = {damage.size for damage in wanted.values()}
    missing = set(wanted)
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if missing and path.is_file() and path.stat().st_size in sizes:
                data = path.read_bytes()
                for address in [a for a in missing if wanted[a].size == len(data) and is_whole(data, a)]:
                    missing.discard(address)
                    yield address, path


def _go_back(store: MapStore, left: tuple[Damage, ...]) -> list[str]:
    """Maps whose newest version is lost open at their last good one; make that the newest."""
    done = []
    bad_records = {(damage.map_id, damage.number) for damage in left if not damage.address}
    bad_blobs = {damage.address for damage in left if damage.address}
    for map_id in sorted({damage.map_id for damage in left}):
        with store.reading() as connection:
            rows = versions.history(connection, map_id)
        good = next((row for row in rows if _is_good(store, row, bad_records, bad_blobs)), None)
        if good is not None and good is not rows[0] and good.kind != "deleted":
            store.undo(map_id, to=good.number)
            done.append(f"map {map_id} is again what it was at version {good.number}")
    return done


def _is_good(store: MapStore, row: VersionRow, bad_records: set[tuple[str, int]], bad_blobs: set[str]) -> bool:
    if (row.map_id, row.number) in bad_records:
        return False
    record: MapRecord = store.record(row)
    return not bad_blobs & {ref.address for ref in record.files.values()}
