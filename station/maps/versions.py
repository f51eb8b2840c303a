"""The rows of the index: one per version of a map, each sealed with a hash over what it says."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from sqlalchemy import Row, delete, func, insert, select
from sqlalchemy.engine import Connection

from station.maps.database import VERSIONS
from station.maps.record_files import RecordFile
from station.model.map_store import VersionKind


@dataclass(frozen=True, slots=True)
class VersionRow:
    """What the index says of a version."""

    map_id: str
    number: int
    kind: VersionKind
    name: str
    places: int
    navigation: str  # id of the navigation, or of several joined by "+"
    created_ms: int  # since 1970
    record: str  # its address
    author: str
    is_sealed: bool = True  # False: the row is not what was written

    @property
    def file(self) -> RecordFile:
        """Its record."""
        return RecordFile(self.map_id, self.number, self.record)

    @property
    def seal(self) -> str:
        """Hash over the row."""
        said: list[str | int] = [self.map_id, self.number, self.kind, self.name, self.places, self.navigation]
        said += [self.created_ms, self.record]
        said += [self.author] if self.author else []  # rows written before there were authors
        return hashlib.sha256(json.dumps(said).encode()).hexdigest()


Rows = list[VersionRow]  # of one map: the newest first


def add(connection: Connection, rows: Iterable[VersionRow]) -> None:
    """Raises DataError (by the transaction) for a number that is taken."""
    values = [{**{key: getattr(row, key) for key in _COLUMNS}, "seal": row.seal} for row in rows]
    if values:
        connection.execute(insert(VERSIONS), values)


def newest_of_all(connection: Connection) -> list[VersionRow]:
    """The newest row of every map, deleted ones too."""
    newest = select(VERSIONS.c.map_id, func.max(VERSIONS.c.number).label("number")).group_by(VERSIONS.c.map_id)
    found = newest.subquery()
    joined = VERSIONS.join(
        found, (VERSIONS.c.map_id == found.c.map_id) & (VERSIONS.c.number == found.c.number)
    )  # fmt: skip
    return _rows(connection.execute(select(VERSIONS).select_from(joined)).all())


def history(connection: Connection, map_id: str) -> list[VersionRow]:
    """All versions of a map, the newest first."""
    found = select(VERSIONS).where(VERSIONS.c.map_id == map_id).order_by(VERSIONS.c.number.desc())
    return _rows(connection.execute(found).all())


def of_navigation(connection: Connection, navigation_id: str) -> list[VersionRow]:
    """Newest rows of the maps whose first navigation is this one, the newest first; deleted ones too."""
    navigation = VERSIONS.c.navigation
    found = select(VERSIONS.c.map_id).where(
        (navigation == navigation_id) | navigation.startswith(f"{navigation_id}+", autoescape=True)
    )
    maps = {str(map_id) for (map_id,) in connection.execute(found.distinct())}
    newest = [history(connection, map_id)[0] for map_id in maps]
    return sorted(newest, key=lambda row: -row.created_ms)


def all_rows(connection: Connection) -> list[VersionRow]:
    return _rows(connection.execute(select(VERSIONS).order_by(VERSIONS.c.map_id, VERSIONS.c.number)).all())


def replace_row(connection: Connection, row: VersionRow) -> None:
    """A row anew, in the place of a damaged one."""
    at = (VERSIONS.c.map_id == row.map_id) & (VERSIONS.c.number == row.number)
    connection.execute(delete(VERSIONS).where(at))
    add(connection, [row])


def forget(connection: Connection, map_id: str, below: int) -> None:
    """Take away the rows of a map with smaller numbers."""
    connection.execute(delete(VERSIONS).where((VERSIONS.c.map_id == map_id) & (VERSIONS.c.number < below)))


_COLUMNS = ("map_id", "number", "kind", "name", "places", "navigation", "created_ms", "record", "author")


def _rows(found: Sequence[Row[tuple[object, ...]]]) -> list[VersionRow]:
    rows = []
    for values in found:
        said = values._mapping
        row = VersionRow(**{key: said[key] for key in _COLUMNS})
        rows.append(replace(row, is_sealed=row.seal == said["seal"]))
    return rows
