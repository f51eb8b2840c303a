"""Whose an SQLite file is, by its header and its tables. It is only looked at: SQLite itself might change it."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

from shared.bounded import shown
from shared.text import printable
from station.maps.address import is_nearly

STAMP = b"SntM"  # the application_id of ours
# https://www.sqlite.org/fileformat.html
_BEGINS = b"SQLite format 3\0"
_WRITES_AT, _WRITES_AHEAD, _HEAD_BYTES = 18, b"\2", 100
_USER_VERSION, _STAMP = slice(60, 64), slice(68, 72)


def why_foreign(path: Path, table: str, columns: set[str], *, in_own_place: bool) -> str:
    """Why a file is another program's, as the predicate of a sentence; empty for one that is ours.

    Ours has the stamp, of which one bit may be wrong. One from before there were stamps has a table of this name, with
    these columns among others. Raises OSError.

    Args:
        in_own_place: it has our file's name in our folder: what cannot be read is ours, and damaged.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    stamp = head[_STAMP]
    if not is_nearly(head[: len(_BEGINS)], _BEGINS):
        return "" if in_own_place else "is no SQLite database"
    if is_nearly(stamp, STAMP):
        return ""
    has_numbers = any(stamp) or any(head[_USER_VERSION]) or head[_WRITES_AT:].startswith(_WRITES_AHEAD)
    if has_numbers and not in_own_place:
        return "is another program's database (its header has that program's numbers)"
    try:
        found, names = _looked_into(path, table)
    except sqlite3.DatabaseError as exc:
        return "" if in_own_place else f"is damaged ({printable(str(exc))}), and may be another program's"
    except UnicodeDecodeError:  # sqlite3 quotes the damaged text in its own error, and cannot
        return "" if in_own_place else "is damaged (it holds text that is none), and may be another program's"
    if found >= columns or not names:
        return ""
    return f"is another program's database (it has {shown(names[0])})"


def _looked_into(path: Path, table: str) -> tuple[set[str], list[str]]:
    """Columns of a table in an SQLite file, and the names of all that is in it. No journal is played back."""
    with contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as connection:
        connection.text_factory = lambda data: data.decode(errors="replace")
        columns = connection.execute(f"PRAGMA table_info({table})").fetchall()
        names = connection.execute("SELECT name FROM sqlite_master ORDER BY name").fetchall()
    return {str(row[1]) for row in columns}, [str(name) for (name,) in names]
