"""Looks at every byte of a map store, and puts right what can be: from checksums, from copies, from older versions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from station.maps import opening, versions
from station.maps.address import is_whole
from station.maps.blobs import Damaged, blob_name
from station.maps.bucket import SCRATCH
from station.maps.purging import ASIDE, purge
from station.maps.record import FOLDER, MapRecord, decode_record, parse_record_name
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
    return (*_damages(store, rows), *_lost(store))


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
    done: list[str] = []
    if not store.open(writes=True):
        return Repair((), ())
    done += [f"version {row.number} of map {row.map_id} was taken in" for row in opening.take_in_records(store)]
    done += _repair_rows(store)
    done += _set_aside(store)
    damages = verify(store)
    wanted = {damage.address: damage for damage in damages if damage.address}
    for address, path in _found_copies(wanted, copies):
        store.bucket.put({blob_name(address): path.read_bytes()})
        done.append(f"{wanted[address].sentence.partition(';')[0]}: copied again from {path}")
    left = verify(store) if done else damages
    done += _go_back(store, left)
    done += collect_garbage(store)
    return Repair(tuple(done), left)


def collect_garbage(store: MapStore) -> list[str]:
    """Remove files no version needs: of purged maps, and of writers that were killed."""
    if next(iter(store.bucket.names(ASIDE)), None) is not None:
        return [f"nothing was tidied up: a record in {ASIDE} may need its files; remove that folder to let them go"]
    with store.reading() as connection:
        rows = versions.all_rows(connection)
    needed: set[str] = set()
    for row in rows:
        try:
            needed |= {ref.address for ref in store.record(row).files.values()}
        except Damaged:
            return ["nothing was tidied up: a damaged version may still need its files"]
    unused = [address for address, age_s in store.blobs.addresses() if address not in needed and age_s > UNUSED_S]
    for address in unused:
        store.bucket.remove(blob_name(address))
    parts = [
        name
        for folder in (FOLDER, "blobs")
        for name, age_s in store.bucket.names(folder)
        if name.rpartition("/")[2].startswith(SCRATCH) and age_s > UNUSED_S
    ]
    for name in parts:
        store.bucket.remove(name)
    return [f"{len(unused) + len(parts)} unused files were removed"] if unused or parts else []


def purge_versions(store: MapStore, map_id: str) -> None:
    """Forget the earlier versions of a map; all of it, without way back, where it was deleted.

    Raises:
        DataError: there is no such map.
    """
    store.open(writes=True)
    newest = store.history(map_id)[0]
    if newest.kind == "deleted":
        purge(store, map_id)
    else:
        with store.database.writing(map_id) as connection:
            old = [row for row in versions.history(connection, map_id) if row.number < newest.number]
            versions.forget(connection, map_id, below=newest.number)
        for row in old:  # after the commit: a record without row and with a smaller number than the newest never counts
            store.bucket.remove(row.record_name)
    collect_garbage(store)


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


def _lost(store: MapStore) -> Iterator[Damage]:
    for lost in opening.lost_records(store):
        yield Damage(lost.map_id, lost.number, "", 0, lost.sentence)


def _set_aside(store: MapStore) -> list[str]:
    """Records that are lost, kept beside the others for whoever can read more out of them."""
    done = []
    for lost in opening.lost_records(store):
        aside = f"{ASIDE}/{lost.name.removeprefix(f'{FOLDER}/')}"
        store.bucket.put({aside: store.bucket.get(lost.name) or b""})
        store.bucket.remove(lost.name)
        with store.reading() as connection:
            rows = versions.history(connection, lost.map_id)
        left = f"it is what it was at version {rows[0].number}" if rows else "nothing else of it is there"
        if rows and rows[0].kind == "deleted":
            left += f", deleted: `station map undo {lost.map_id}` brings it back"
        done.append(f"version {lost.number} of map {lost.map_id} is lost (its record is {aside} now); {left}")
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
