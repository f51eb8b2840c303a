"""Maps that survive: versions of documents and checksummed files, indexed in SQL (docs/maps.md, decision 4)."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from sqlalchemy.engine import Connection

from shared.errors import DataError
from station.files.navigation_folder import encode_navigation
from station.files.unwritable import Unwritable, cannot_write, why_unwritable
from station.maps import versions
from station.maps.blobs import Damaged, Notify
from station.maps.bucket import open_bucket
from station.maps.contents import Contents
from station.maps.database import Database
from station.maps.index_copy import IndexCopy
from station.maps.opening import has_content, open_contents
from station.maps.plan_files import plan_files
from station.maps.record import (
    MAP_ID,
    MapRecord,
    describe_map,
    read_map,
    same_content,
)
from station.maps.versions import Rows
from station.model.map_store import MapSummary, StoreAddress
from station.model.place_map import PlaceMap

logger = logging.getLogger(__name__)


class MapStore:
    """Maps by id. Methods block: call them in a thread. Several stores, processes and stations may share one address.

    All methods raise DataError when the store cannot be read or written, in a sentence; nothing is left half-written.
    In a folder that takes no writes the maps can still be seen (index_copy.py).
    """

    def __init__(self, where: Path | StoreAddress, notify: Notify = logger.warning) -> None:
        """`notify` hears a sentence about everything found damaged, whether it was put right or not."""
        self.address = StoreAddress(where) if isinstance(where, Path) else where
        self.notify = notify
        database = Database(self.address.database, self.address.root)
        bucket = open_bucket(self.address.blobs, self.address.root)
        self._home = Contents(database, bucket, self.address.author, notify)
        self._copy: IndexCopy | None = None  # where nothing can be written: what is looked at instead
        self._notified = ""
        self._opening = threading.Lock()
        self._is_open = False

    def save(self, place_map: PlaceMap, why: str = "saved") -> None:
        """Keep a map as the newest version of its id; nothing happens when that is the same already."""
        if not MAP_ID.fullmatch(place_map.id):
            raise DataError(f'map id "{place_map.id}" is no file name; use letters, digits, "-" and "_"')
        self.for_writing().save(place_map, why)

    def edit(self, map_id: str, change: Callable[[PlaceMap], PlaceMap], why: str) -> tuple[PlaceMap, int | None]:
        """Change places, rooms or names of a map. Two stations that edit at once keep both changes.

        Returns:
            The map as it is then, and the version that the change led to; None: it was so already.
        """
        contents = self.for_writing()
        with contents.bucket.adding(), contents.changing(map_id) as changing:
            record = self._present(changing.rows, map_id)
            place_map = change(read_map(record, contents.blobs))
            files = {**record.files, **contents.put(plan_files(place_map))}
            fresh = replace(describe_map(place_map, files), why=why)
            version = None if same_content(record, fresh) else changing.append(fresh, record, "edited").number
        return place_map, version

    def rebuild(
        self, built: PlaceMap, navigation_id: str, take_over: Callable[[PlaceMap, PlaceMap | None], PlaceMap], why: str
    ) -> PlaceMap:
        """Keep a map that was made anew, with what people made of the one before, and return it.

        `take_over` gets it and the newest map of the navigation, which nobody changes meanwhile where it has the same
        id. Where it was made of the same files that is one more change of it: undo leads on to those before.
        """
        contents = self.for_writing()
        with contents.bucket.adding():
            files = contents.put(encode_navigation(built.navigation))  # large: nobody has to wait for it
            with contents.changing(built.id) as changing:
                place_map = take_over(built, self.newest_of_navigation(navigation_id))
                fresh = replace(describe_map(place_map, {**files, **contents.put(plan_files(place_map))}), why=why)
                newest = contents.newest(changing.rows)
                if newest is None or newest.kind == "deleted":
                    changing.append(fresh, newest, "saved")
                elif not same_content(newest, fresh):
                    has_same_files = files.items() <= newest.files.items()
                    changing.append(fresh, newest, "edited" if has_same_files else "saved")
        return place_map

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
            raise self.contents.no_map(map_id)
        contents = self.contents
        failure: Damaged | None = None
        for row in rows:
            try:
                place_map = read_map(contents.record(row), contents.blobs)
            except Damaged as exc:
                failure = failure or exc
                continue
            if failure is not None:
                self.notify(f"{failure}. Version {row.number} of the map is used instead")
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
            MapSummary(row.map_id, row.name, row.places, "" if row.is_sealed else self.contents.unsealed(row))
            for row in rows
            if row.kind != "deleted"
        ]
        summaries += [MapSummary(map_id, map_id, 0, damaged=why) for map_id, why in self.contents.not_imported.items()]
        return tuple(sorted(summaries, key=lambda s: (s.name, s.id)))

    def records(self) -> tuple[MapRecord, ...]:
        """The newest version of every map that is not deleted and can be read, the one changed last first."""
        if not self.open():
            return ()
        with self.reading() as connection:
            rows = [row for row in versions.newest_of_all(connection) if row.kind != "deleted"]
        found = []
        for row in rows:
            with contextlib.suppress(Damaged):  # `list` tells of it
                found.append(self.contents.record(row))
        return tuple(sorted(found, key=lambda record: -record.created_ms))

    def history(self, map_id: str) -> tuple[MapRecord, ...]:
        """The versions of a map that can be read, the newest first. Raises DataError when there is none of this id."""
        rows = self._history(map_id)
        if not rows:
            raise self.contents.no_map(map_id)
        records = []
        for row in rows:
            try:
                records.append(self.contents.record(row))
            except Damaged as exc:
                self.notify(str(exc))
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
        with self.for_writing().changing(map_id) as change:
            record = self._present(change.rows, map_id)
            change.append(replace(record, why="deleted"), record, "deleted")

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
        contents = self.for_writing()
        with contents.changing(map_id) as change:
            newest = contents.newest(change.rows)
            if newest is None:
                raise self.contents.no_map(map_id)
            if newest_is is not None and newest.number != newest_is:
                raise DataError(
                    f"map {map_id} was changed since: it is at version {newest.number}, not {newest_is}; look again"
                )
            target = to if to is not None else self._before(change.rows, newest)
            row = next((row for row in change.rows if row.number == target), None)
            if row is None:
                wanted = f"has no version {to}" if to is not None else "has no earlier version"
                raise DataError(f"map {map_id} {wanted}; `station map history {map_id}` lists them")
            record = contents.record(row)
            why = f"version {record.content} again"
            name = newest.name if keeps_name else record.name
            return change.append(replace(record, why=why, name=name), record, "restored")

    def open(self, *, writes: bool = False) -> bool:
        """Once: check, migrate, index what is there. False when there is nothing yet and nothing is to be written.

        Raises Unwritable for `writes` in a folder that takes none; when it does again all is as ever.
        """
        with self._opening:
            if self._copy is not None and not self._copy.is_needed:
                self._leave_copy()
            if self._copy is None and not self._is_open:
                if not writes and not self._home.database.exists and not has_content(self._home, self.address.root):
                    return False
                try:
                    open_contents(self._home, self.address.root)
                    self._is_open = True
                except Unwritable as exc:
                    self._look_at_copy(exc)
            if self._copy is not None and writes:
                raise Unwritable(self._copy.refusal)
            return True

    @property
    def contents(self) -> Contents:
        """What is in it, once it is open: on a copy of the index where the folder takes no writes."""
        copy = self._copy
        return self._home if copy is None else copy.contents

    def for_writing(self) -> Contents:
        """Open it, to change what is in it. Raises Unwritable where nothing can be kept."""
        self.open(writes=True)
        return self._home

    @property
    def is_copy(self) -> bool:
        """The folder takes no writes; a copy of the index is looked at."""
        return self._copy is not None

    def require_writable(self) -> None:
        """Before long work whose result is to be kept here. Raises DataError."""
        try:
            self.open(writes=True)
        except Unwritable:
            self.close()  # a worker that is refused ends without tidying up, and need not look on
            raise
        if self._home.database.is_sqlite and (told := why_unwritable(self.address.root)):
            raise cannot_write(self.address.root, told)

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction on the index of a store that is open; on a copy where SQLite cannot read without writing."""
        with contextlib.ExitStack() as stack:
            try:
                connection = stack.enter_context(self.contents.database.reading())
            except Unwritable as exc:  # a write was cut while this store was open
                with self._opening:
                    if not self.is_copy:
                        self._look_at_copy(exc)
                connection = stack.enter_context(self.contents.database.reading())
            yield connection

    def close(self) -> None:
        self._leave_copy()
        self._home.database.close()

    def _look_at_copy(self, because: Unwritable) -> None:
        if not self._home.database.is_sqlite:
            raise because
        copy = IndexCopy(self.address.root, self._home, because)
        try:
            open_contents(copy.contents, self.address.root, is_copy=True)
        except BaseException:
            copy.remove()
            raise
        self._copy = copy
        if copy.refusal != self._notified:
            self._notified = copy.refusal
            self.notify(self._notified)

    def _leave_copy(self) -> None:
        if self._copy is not None:
            copy, self._copy, self._is_open = self._copy, None, False
            copy.remove()

    def _before(self, rows: Rows, newest: MapRecord) -> int | None:
        """The version that undoing the newest leads to."""
        if newest.kind == "deleted":
            return newest.content
        if newest.kind != "restored":
            return newest.previous
        first = next((row for row in rows if row.number == newest.content), None)
        return None if first is None else self.contents.record(first).previous

    def _history(self, map_id: str) -> Rows:
        if not self.open():
            return []
        with self.reading() as connection:
            return versions.history(connection, map_id)

    def _present(self, rows: Rows, map_id: str) -> MapRecord:
        record = self.contents.newest(rows)
        if record is None or record.kind == "deleted":
            raise self.contents.no_map(map_id)
        return record
