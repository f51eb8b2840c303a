"""The index of a store and the files that it names: versions are read, checked and appended here."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace

from sqlalchemy.engine import Connection

from shared.errors import DataError
from station.maps import versions
from station.maps.address import address_of
from station.maps.blobs import Blobs, Damaged, Notify, read_checked
from station.maps.bucket import Bucket
from station.maps.database import Database
from station.maps.record import (
    FileRef,
    MapRecord,
    decode_record,
    describe_map,
    encode_record,
    map_files,
    same_content,
)
from station.maps.versions import Rows, VersionRow
from station.model.map_store import VersionKind
from station.model.place_map import PlaceMap


class NoSuchMap(DataError):
    """A store holds no map of this id."""


class Contents:
    """What a store holds, in its own place or on a copy of its index. Nothing is checked before the first use: open it.

    All methods raise DataError when it cannot be read or written; nothing is left half-written.
    """

    def __init__(self, database: Database, bucket: Bucket, author: str, notify: Notify) -> None:
        """`author`: the station's name, written with every version. `notify` hears of everything found damaged."""
        self.database = database
        self.bucket = bucket
        self.blobs = Blobs(bucket, notify)
        self.author = author
        self.notify = notify
        self.not_imported: dict[str, str] = {}  # maps in the old format that cannot be read: id → why

    def save(self, place_map: PlaceMap, why: str) -> None:
        """Make a map the newest version of its id; nothing happens when that is the same already."""
        with self.bucket.adding():
            self.save_record(replace(describe_map(place_map, self.put(map_files(place_map))), why=why))

    def put(self, files: Mapping[str, bytes]) -> dict[str, FileRef]:
        """Keep files, and what a record says of them. Until that is written nobody shall tidy: `bucket.adding`."""
        addresses = self.blobs.put(files.values())
        return {
            name: FileRef(address, len(data))
            for (name, data), address in zip(files.items(), addresses, strict=True)
        }  # fmt: skip

    def save_record(self, content: MapRecord) -> bool:
        """As save, of a record whose files are here. False: it is the newest version already."""
        with self.changing(content.map_id) as change:
            newest = self.newest(change.rows)
            if newest is not None and newest.kind != "deleted" and same_content(newest, content):
                return False
            change.append(content, newest, "saved")
        return True

    @contextlib.contextmanager
    def changing(self, map_id: str) -> Iterator[Change]:
        """A transaction, alone on this map. Where it fails its records go too, or the next start would index them."""
        written: list[str] = []
        try:
            with self.database.writing(map_id) as connection:
                yield Change(self, connection, versions.history(connection, map_id), written)
        except Exception:
            for name in written:
                with contextlib.suppress(DataError):
                    self.bucket.remove(name)
            raise

    def newest(self, rows: Rows) -> MapRecord | None:
        """The newest record of a map's rows that can be read. Raises Damaged when there are some and none can."""
        failure: Damaged | None = None
        for row in rows:
            try:
                return self.record(row)
            except Damaged as exc:
                failure = failure or exc
                self.notify(str(exc))
        if failure is not None:
            raise failure
        return None

    def record(self, row: VersionRow) -> MapRecord:
        """The record of a row, checked. Raises Damaged."""
        return self.record_and_bytes(row)[0]

    def record_and_bytes(self, row: VersionRow) -> tuple[MapRecord, bytes]:
        """The record of a row and the bytes it was decoded from. Raises Damaged."""
        if not row.is_sealed:
            raise Damaged(self.unsealed(row))
        what = f"map {row.map_id}, version {row.number}"
        data = read_checked(self.bucket, row.file.name, row.record, what, self.notify)
        record = decode_record(data, what)
        if (record.map_id, record.number) != (row.map_id, row.number):
            raise Damaged(
                f"{what}: its record is of {record.map_id}, version {record.number}; run `station map repair`"
            )
        return record, data

    def no_map(self, map_id: str) -> NoSuchMap:
        """What to raise where there is no map of this id."""
        rows: Rows = []
        if self.database.exists:
            with self.database.reading() as connection:
                rows = versions.newest_of_all(connection)
        kept = {row.map_id for row in rows if row.kind != "deleted"}
        known = ", ".join(sorted(kept | self.not_imported.keys())) or "none"
        return NoSuchMap(f'{self.bucket.place} holds no map "{map_id}"; its maps: {known}')

    def unsealed(self, row: VersionRow) -> str:
        """What to say of a row that is not what was written."""
        return (
            f"{self.database.place}: version {row.number} of map {row.map_id} is damaged (its seal differs); "
            "run `station map repair`"
        )


class Change:
    """A transaction on one map."""

    def __init__(self, contents: Contents, connection: Connection, rows: Rows, written: list[str]) -> None:
        self.rows = rows  # of the map, the newest first
        self._contents = contents
        self._connection = connection
        self._written = written  # names of records, for whoever must undo it

    def append(self, content: MapRecord, before: MapRecord | None, kind: VersionKind) -> MapRecord:
        """Write a new version: its record first, then its row, which the transaction commits."""
        number = self.rows[0].number + 1 if self.rows else 1
        is_new = kind in ("saved", "edited")
        record = replace(
            content,
            number=number,
            kind=kind,
            author=self._contents.author,
            created_ms=time.time_ns() // 1_000_000,
            previous=None if before is None else before.content,
            content=number if is_new else content.content,
        )
        data = encode_record(record)
        row = row_of(record, data)
        self._written.append(row.file.name)
        self._contents.bucket.put({row.file.name: data})
        versions.add(self._connection, [row])
        return record


def row_of(record: MapRecord, data: bytes) -> VersionRow:
    """The row of a record, and of the bytes it was written as."""
    return VersionRow(
        record.map_id,
        record.number,
        record.kind,
        record.name,
        len(record.places),
        record.navigation,
        record.created_ms,
        address_of(data),
        record.author,
    )
