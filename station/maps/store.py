"""Maps that survive: versions of documents and checksummed files, indexed in SQL (docs/maps.md, decision 4)."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from sqlalchemy.engine import Connection

from shared.errors import DataError
from station.files.navigation_folder import REPORT, encode_navigation
from station.files.unwritable import Unwritable, cannot_write, why_unwritable
from station.maps import versions
from station.maps.blobs import Blobs, Damaged, Tell, read_checked
from station.maps.bucket import Bucket, open_bucket
from station.maps.database import Database
from station.maps.editing import with_place_renamed
from station.maps.index_copy import IndexCopy
from station.maps.record import (
    MAP_ID,
    FileRef,
    Kind,
    MapRecord,
    content_hash,
    decode_record,
    describe_map,
    encode_record,
    read_map,
    record_name,
)
from station.maps.repair import opening
from station.maps.versions import Rows, VersionRow, row_of
from station.model.place_map import PlaceMap

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class StoreAddress:
    """Where a store is. Picklable: worker processes are given it."""

    root: Path  # the folder of maps.db, blobs and records where no URL says otherwise
    database: str = ""  # postgresql://user@host/name; empty: SQLite in the folder
    blobs: str = ""  # a URL that fsspec knows; empty: in the folder
    author: str = ""  # the station's name, kept with every version it writes


@dataclass(frozen=True, slots=True)
class MapSummary:
    """What a list of maps shows, without reading clouds and images."""

    id: str
    name: str
    places: int
    damaged: str = ""  # a sentence, where the map cannot be read


class MapStore:
    """Maps by id. Methods block: call them in a thread. Several stores, processes and stations may share one address.

    All methods raise DataError when the store cannot be read or written, in a sentence; nothing is left half-written.
    In a folder that takes no writes the maps can still be seen (index_copy.py).
    """

    def __init__(self, where: Path | StoreAddress, tell: Tell = logger.warning) -> None:
        """`tell` hears a sentence about everything found damaged, whether it was put right or not."""
        self.address = StoreAddress(where) if isinstance(where, Path) else where
        self.tell = tell
        self._home = Database(self.address.database, self.address.root)
        self._files = open_bucket(self.address.blobs, self.address.root)
        self._use(self._home, self._files)
        self._copy: IndexCopy | None = None  # where nothing can be written: what is looked at instead
        self._told = ""
        self._written = threading.local()  # .names: records of the transaction under way
        self._opening = threading.Lock()
        self._is_open = False
        self._not_imported: dict[str, str] = {}  # maps in the old format that cannot be read: id → why

    def save(self, place_map: PlaceMap, why: str = "saved") -> None:
        """Keep a map as the newest version of its id; nothing happens when that is the same already."""
        if not MAP_ID.fullmatch(place_map.id):
            raise DataError(f'map id "{place_map.id}" is no file name; use letters, digits, "-" and "_"')
        self.open(writes=True)
        self.keep(place_map, why)

    def keep(self, place_map: PlaceMap, why: str) -> None:
        """As save, of a store that is open."""
        contents = encode_navigation(place_map.navigation)
        addresses = self.blobs.put(contents.values())
        files = {
            name: FileRef(address, len(data))
            for (name, data), address in zip(contents.items(), addresses, strict=True)
        }  # fmt: skip
        fresh = replace(describe_map(place_map, files), why=why)
        with self._changing(place_map.id) as connection:
            rows = versions.history(connection, place_map.id)
            newest = self._readable(rows)
            if newest is not None and newest.kind != "deleted" and _same_content(newest, fresh):
                return
            self._append(connection, rows, fresh, newest, "saved")

    def edit(self, map_id: str, change: Callable[[PlaceMap], PlaceMap], why: str) -> PlaceMap:
        """Change places, edges or names of a map and return it. Two stations that edit at once keep both changes."""
        self.open(writes=True)
        with self._changing(map_id) as connection:
            rows = versions.history(connection, map_id)
            record = self._present(rows, map_id)
            place_map = change(read_map(record, self.blobs))
            fresh = replace(describe_map(place_map, record.files), why=why)
            if not _same_content(record, fresh):
                self._append(connection, rows, fresh, record, "edited")
        return place_map

    def rename_place(self, map_id: str, place_id: str, name: str) -> PlaceMap:
        """Give a place another name, and return the map. Raises DataError for an unknown place or a name in use."""
        why = f"{place_id} is now {name.strip()}"[:200]
        return self.edit(map_id, lambda place_map: with_place_renamed(place_map, place_id, name), why)

    def load(self, map_id: str, number: int | None = None) -> PlaceMap:
        """Read a map, or one of its versions. Where the newest is damaged the last good one is read, and it is told.

        Raises:
            DataError: no map of this id, or Damaged: no version of it can be read; names the file.
        """
        rows = self._history(map_id)
        if number is not None:
            rows = [row for row in rows if row.number == number]
            if not rows:
                raise DataError(f"map {map_id} has no version {number}; `station map history {map_id}` lists them")
        elif not rows or rows[0].kind == "deleted":
            raise self.no_map(map_id)
        failure: Damaged | None = None
        for row in rows:
            try:
                place_map = read_map(self.record(row), self.blobs)
            except Damaged as exc:
                failure = failure or exc
                continue
            if failure is not None:
                self.tell(f"{failure}. Version {row.number} of the map is used instead")
            return place_map
        assert failure is not None
        raise failure

    def newest_of_navigation(self, navigation_id: str) -> PlaceMap | None:
        """The map changed last of those that were made from this navigation, alone or with others behind it."""
        if not self.open():
            return None
        with self.reading() as connection:
            rows = versions.of_navigation(connection, navigation_id)
        for row in rows:
            if row.kind != "deleted":
                return self.load(row.map_id)
        return None

    def list(self) -> tuple[MapSummary, ...]:
        """All maps, by name; a damaged one says so instead of hiding the others."""
        if not self.open():
            return ()
        with self.reading() as connection:
            rows = versions.newest_of_all(connection)
        summaries = [
            MapSummary(row.map_id, row.name, row.places, "" if row.is_sealed else self._unsealed(row))
            for row in rows
            if row.kind != "deleted"
        ]
        summaries += [MapSummary(map_id, map_id, 0, damaged=why) for map_id, why in self._not_imported.items()]
        return tuple(sorted(summaries, key=lambda s: (s.name, s.id)))

    def history(self, map_id: str) -> tuple[MapRecord, ...]:
        """The versions of a map that can be read, the newest first. Raises DataError when there is none of this id."""
        rows = self._history(map_id)
        if not rows:
            raise self.no_map(map_id)
        records = []
        for row in rows:
            try:
                records.append(self.record(row))
            except Damaged as exc:
                self.tell(str(exc))
        return tuple(records)

    def deleted(self) -> tuple[MapSummary, ...]:
        """Maps that `undo` brings back."""
        if not self.open():
            return ()
        with self.reading() as connection:
            rows = versions.newest_of_all(connection)
        return tuple(MapSummary(row.map_id, row.name, row.places) for row in rows if row.kind == "deleted")

    def delete(self, map_id: str) -> None:
        """Forget a map; `undo` brings it back until it is purged. Raises DataError when there is none of this id."""
        self.open(writes=True)
        with self._changing(map_id) as connection:
            rows = versions.history(connection, map_id)
            record = self._present(rows, map_id)
            self._append(connection, rows, replace(record, why="deleted"), record, "deleted")

    def undo(
        self, map_id: str, to: int | None = None, *, newest_is: int | None = None, keeps_name: bool = False
    ) -> MapRecord:
        """Take back the last change, also a deletion; again: the one before. `to`: go to this version instead.

        Args:
            newest_is: the version the caller saw last; nothing happens when there is a newer one by now.
            keeps_name: the map stays named as it is, whatever it was called then.
        Raises:
            DataError: there is nothing to take back, no such version, or a newer one than `newest_is`.
        """
        self.open(writes=True)
        with self._changing(map_id) as connection:
            rows = versions.history(connection, map_id)
            newest = self._readable(rows)
            if newest is None:
                raise self.no_map(map_id)
            if newest_is is not None and newest.number != newest_is:
                raise DataError(
                    f"map {map_id} was changed since: it is at version {newest.number}, not {newest_is}; look again"
                )
            target = to if to is not None else self._before(rows, newest)
            row = next((row for row in rows if row.number == target), None)
            if row is None:
                wanted = f"has no version {to}" if to is not None else "has no earlier version"
                raise DataError(f"map {map_id} {wanted}; `station map history {map_id}` lists them")
            record = self.record(row)
            why = f"version {record.content} again"
            name = newest.name if keeps_name else record.name
            return self._append(connection, rows, replace(record, why=why, name=name), record, "restored")

    def append_restored(self, content: MapRecord) -> bool:
        """Make this content (of a backup; its blobs are here) the newest version; False when it is that already."""
        with self._changing(content.map_id) as connection:
            rows = versions.history(connection, content.map_id)
            newest = self._readable(rows)
            if newest is not None and newest.kind != "deleted" and _same_content(newest, content):
                return False
            self._append(connection, rows, replace(content, why="from a backup"), newest, "saved")
        return True

    def content_hash(self, map_id: str) -> str:
        """What the newest version is, whoever made it and when (record.content_hash)."""
        record = self._present(self._history(map_id), map_id)
        return content_hash(record, self.blobs.get(record.files[REPORT].address, f"map {map_id}: {REPORT}"))

    def record(self, row: VersionRow) -> MapRecord:
        """The record of a row, checked. Raises Damaged."""
        return self.record_and_bytes(row)[0]

    def record_and_bytes(self, row: VersionRow) -> tuple[MapRecord, bytes]:
        """The same, and what it was decoded from."""
        if not row.is_sealed:
            raise Damaged(self._unsealed(row))
        what = f"map {row.map_id}, version {row.number}"
        data = read_checked(self.bucket, row.record_name, row.record, what, self.tell)
        record = decode_record(data, what)
        if (record.map_id, record.number) != (row.map_id, row.number):
            raise Damaged(
                f"{what}: its record is of {record.map_id}, version {record.number}; run `station map repair`"
            )
        return record, data

    def open(self, *, writes: bool = False) -> bool:
        """Once: check, migrate, take in what is there. False when there is nothing yet and nothing is to be written.

        Raises Unwritable for `writes` in a folder that takes none; when it does again all is as ever.
        """
        with self._opening:
            if self._copy is not None and not self._copy.is_needed:
                self._leave_copy()
            if self._copy is None and not self._is_open:
                if not writes and not self.database.exists and not opening.has_content(self):
                    return False
                try:
                    self._not_imported = opening.open_store(self)
                    self._is_open = True
                except Unwritable as exc:
                    self._look_at_copy(exc)
            if self._copy is not None and writes:
                raise Unwritable(self._copy.refusal)
            return True

    @property
    def is_copy(self) -> bool:
        """The folder takes no writes; a copy of the index is looked at, and may be changed like any."""
        return self._copy is not None

    def require_writable(self) -> None:
        """Before long work whose result is to be kept here. Raises DataError."""
        try:
            self.open(writes=True)
        except Unwritable:
            self.close()  # a worker that is refused ends without tidying up, and need not look on
            raise
        if self.database.is_sqlite and (told := why_unwritable(self.address.root)):
            raise cannot_write(self.address.root, told)

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction on the index of a store that is open; on a copy where SQLite cannot read without writing."""
        with contextlib.ExitStack() as stack:
            try:
                connection = stack.enter_context(self.database.reading())
            except Unwritable as exc:  # a write was cut while this store was open
                with self._opening:
                    if self._copy is None:
                        self._look_at_copy(exc)
                connection = stack.enter_context(self.database.reading())
            yield connection

    def close(self) -> None:
        self._leave_copy()
        self.database.close()

    def _use(self, database: Database, bucket: Bucket) -> None:
        self.database, self.bucket, self.blobs = database, bucket, Blobs(bucket, self.tell)

    def _look_at_copy(self, because: Unwritable) -> None:
        if not self.database.is_sqlite:
            raise because
        self._copy = IndexCopy(self.address.root, self._home, self._files, because)
        self._use(self._copy.database, self._copy.bucket)
        self._written.opens = True
        try:
            self._not_imported = opening.open_store(self)
        except BaseException:
            self._leave_copy()
            raise
        finally:
            self._written.opens = False
        if self._copy.refusal != self._told:
            self._told = self._copy.refusal
            self.tell(self._told)

    def _leave_copy(self) -> None:
        if self._copy is not None:
            self._use(self._home, self._files)
            self._copy.remove()
            self._copy, self._is_open = None, False

    @contextlib.contextmanager
    def _changing(self, map_id: str) -> Iterator[Connection]:
        """A transaction, alone on this map. Where it fails its records go too, or the next start would take them in."""
        if self._copy is not None and not getattr(self._written, "opens", False):
            raise Unwritable(self._copy.refusal)  # another thread found just now that nothing can be kept here
        written: list[str] = []
        self._written.names = written
        try:
            with self.database.writing(map_id) as connection:
                yield connection
        except Exception:
            for name in written:
                with contextlib.suppress(DataError):
                    self.bucket.remove(name)
            raise

    def _append(
        self,
        connection: Connection,
        rows: Rows,
        content: MapRecord,
        before: MapRecord | None,
        kind: Kind,
    ) -> MapRecord:
        """Write a new version: its record first, then its row; the caller's transaction commits it."""
        number = rows[0].number + 1 if rows else 1
        is_new = kind in ("saved", "edited")
        record = replace(
            content,
            number=number,
            kind=kind,
            author=self.address.author,
            created_ms=time.time_ns() // 1_000_000,
            previous=None if before is None else before.content,
            content=number if is_new else content.content,
        )
        data = encode_record(record)
        self._written.names.append(record_name(record, data))
        self.bucket.put({record_name(record, data): data})
        versions.add(connection, [row_of(record, data)])
        return record

    def _before(self, rows: Rows, newest: MapRecord) -> int | None:
        """The version that undoing the newest leads to."""
        if newest.kind == "deleted":
            return newest.content
        if newest.kind != "restored":
            return newest.previous
        first = next((row for row in rows if row.number == newest.content), None)
        return None if first is None else self.record(first).previous

    def _history(self, map_id: str) -> Rows:
        if not self.open():
            return []
        with self.reading() as connection:
            return versions.history(connection, map_id)

    def _readable(self, rows: Rows) -> MapRecord | None:
        """The newest record that can be read. Raises Damaged when there are some and none can."""
        failure: Damaged | None = None
        for row in rows:
            try:
                return self.record(row)
            except Damaged as exc:
                failure = failure or exc
                self.tell(str(exc))
        if failure is not None:
            raise failure
        return None

    def _present(self, rows: Rows, map_id: str) -> MapRecord:
        record = self._readable(rows)
        if record is None or record.kind == "deleted":
            raise self.no_map(map_id)
        return record

    def no_map(self, map_id: str) -> DataError:
        """What to raise where there is no map of this id."""
        known = ", ".join(sorted(summary.id for summary in self.list())) or "none"
        return DataError(f'{self.bucket.place} holds no map "{map_id}"; its maps: {known}')

    def _unsealed(self, row: VersionRow) -> str:
        return (
            f"{self.database.place}: version {row.number} of map {row.map_id} is damaged (its seal differs); "
            "run `station map repair`"
        )


def _same_content(a: MapRecord, b: MapRecord) -> bool:
    """Whether two records say the same of the map."""
    unplaced = replace(b, **{key: getattr(a, key) for key in _HISTORY})
    return encode_record(a) == encode_record(unplaced)


_HISTORY = ("number", "kind", "why", "author", "created_ms", "previous", "content")
