"""The first use of a map store: check, migrate, take in records without a row, import folders of the old format."""

from __future__ import annotations

import os
import re
from pathlib import Path

from shared.errors import DataError
from station.files.unwritable import Unwritable
from station.maps import versions
from station.maps.contents import Contents, row_of
from station.maps.database import IndexDamaged
from station.maps.folder import load_map_folder
from station.maps.record import MapRecord
from station.maps.record_files import FOLDER
from station.maps.unclaimed import newer, read_all, without_row
from station.maps.versions import VersionRow

IMPORTED = "imported"  # where folders of the old format go when their map is in the store
_OLD = re.compile(r"(?P<id>[A-Za-z0-9][A-Za-z0-9_-]{0,99})\.(?P<number>\d{6})")


def has_content(contents: Contents, root: Path) -> bool:
    """Whether there is anything to open."""
    return bool(_old_folders(root)) or next(iter(contents.bucket.names(FOLDER)), None) is not None


def open_contents(contents: Contents, root: Path, *, is_copy: bool = False) -> None:
    """Make a store in the folder `root` usable; maps of the old format that cannot be read are in its `not_imported`.

    Raises Unwritable where that needs a write and there can be none; in a copy of the index it can be done then.
    Raises DataError where the settings name another program's database.
    """
    contents.database.refuse_foreign()
    try:
        was_empty = contents.database.migrate()
        if not was_empty:
            contents.database.check()
        index_unclaimed(contents)
    except IndexDamaged as exc:
        if not contents.database.is_sqlite:
            raise
        aside = contents.database.set_aside()
        done = "what is shown is" if is_copy else f"it is set aside as {aside.name} and"
        contents.notify(f"{exc}; {done} made again from the records")
        contents.database.migrate()
        index_unclaimed(contents)
    contents.not_imported = _import_folders(contents, root, is_copy=is_copy)


def index_unclaimed(contents: Contents) -> list[VersionRow]:
    """Rows for whole records that have none and are newer than those that have.

    Such a record was written by a program that was killed before it could commit, or its row was lost with the index.
    SQLite only: there the transaction keeps every other writer out, so that none of them is in between.
    """
    if not contents.database.is_sqlite:
        return []
    with contents.database.reading() as connection:
        rows = versions.all_rows(connection)
    if any(not row.is_sealed for row in rows):
        raise IndexDamaged(f"{contents.database.place} is damaged (a row's seal differs)")
    if not newer(without_row(contents.bucket, rows), rows):
        return []
    with contents.database.writing(FOLDER) as connection:
        rows = versions.all_rows(connection)
        found: dict[tuple[str, int], tuple[MapRecord, VersionRow]] = {}
        there = {address for address, _ in contents.blobs.addresses()}
        for one in read_all(contents.bucket, newer(without_row(contents.bucket, rows), rows), contents.notify):
            if one.record is None or one.data is None:
                contents.notify(one.sentence)
                continue
            key = one.file.map_id, one.file.number
            # Two of one number: the later one was committed, the other's writer was killed before.
            if {ref.address for ref in one.record.files.values()} <= there and (
                key not in found or found[key][0].created_ms < one.record.created_ms
            ):
                found[key] = one.record, row_of(one.record, one.data)
        taken = [row for _, row in found.values()]
        versions.add(connection, taken)
    return taken


def _import_folders(contents: Contents, root: Path, *, is_copy: bool) -> dict[str, str]:
    """Maps of the old format, a folder each. The folders are kept, under another name. Returns those it cannot read."""
    failed = {}
    for map_id, folders in _old_folders(root).items():
        try:
            contents.save(load_map_folder(max(folders)), f"imported from {max(folders).name}")
        except DataError as exc:
            if isinstance(exc, Unwritable) and contents.database.is_sqlite and not is_copy:
                raise  # a copy can take it in
            failed[map_id] = str(exc)
            continue
        if is_copy:
            continue  # the next opening in a folder that takes writes does it for good
        try:
            (root / IMPORTED).mkdir(exist_ok=True)
            for folder in folders:
                os.rename(folder, root / IMPORTED / folder.name)
        except OSError as exc:
            contents.notify(f"{folders[0]} was imported but cannot be moved away ({exc.strerror})")
    return failed


def _old_folders(root: Path) -> dict[str, list[Path]]:
    """Map id → its folders: every number there is."""
    found: dict[str, list[Path]] = {}
    for folder in sorted(root.iterdir()) if root.is_dir() else []:
        if (match := _OLD.fullmatch(folder.name)) and folder.is_dir():
            found.setdefault(match["id"], []).append(folder)
    return found
