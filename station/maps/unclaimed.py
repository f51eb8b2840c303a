"""Records that no row of the index names: lost together with it, or left by a writer or a purge that was killed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from station.maps.blobs import Damaged, read_checked
from station.maps.contents import Contents
from station.maps.record import FOLDER, MapRecord, decode_record, parse_record_name
from station.maps.versions import VersionRow

ASIDE = "damaged"  # the folder of records that repair gave up


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A record by the name of its file."""

    map_id: str
    number: int  # of the version
    address: str
    name: str  # in the bucket


@dataclass(frozen=True, slots=True)
class Unclaimed:
    """A record without a row, read."""

    file: RecordFile
    data: bytes
    record: MapRecord | None  # None: it is damaged
    sentence: str  # how; empty while it is whole


def record_files(contents: Contents, folder: str = FOLDER) -> Iterator[RecordFile]:
    """All records, or those that were set aside; not what a killed writer left half-written."""
    for name, _ in contents.bucket.names(folder):
        parsed = parse_record_name(f"{FOLDER}/{name.removeprefix(f'{folder}/')}")
        if parsed is not None:
            yield RecordFile(*parsed, name)


def without_row(contents: Contents, rows: list[VersionRow]) -> list[RecordFile]:
    """Records that these rows do not name."""
    named = {row.record_name for row in rows}
    return [file for file in record_files(contents) if file.name not in named]


def newer(files: list[RecordFile], rows: list[VersionRow]) -> list[RecordFile]:
    """Those that no version of their map with a row is newer than: the others never count."""
    newest: dict[str, int] = {}
    for row in rows:
        newest[row.map_id] = max(row.number, newest.get(row.map_id, 0))
    return [file for file in files if file.number > newest.get(file.map_id, 0)]


def read_all(contents: Contents, files: list[RecordFile]) -> Iterator[Unclaimed]:
    """One with a single wrong bit is put right on the way."""
    for file in files:
        what = f"map {file.map_id}, version {file.number}"
        try:
            data = read_checked(contents.bucket, file.name, file.address, what, contents.tell)
            yield Unclaimed(file, data, decode_record(data, what), "")
        except Damaged as exc:
            left = contents.bucket.get(file.name)
            if left is not None:  # else a writer that failed took it away just now
                yield Unclaimed(file, left, None, str(exc))
