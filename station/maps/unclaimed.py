"""Records that no row of the index names: lost together with it, or left by a writer or a purge that was killed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from station.maps.blobs import Damaged, Notify, read_checked
from station.maps.bucket import Bucket, Unreadable
from station.maps.record import MapRecord, decode_record
from station.maps.record_files import RecordFile, record_files
from station.maps.versions import VersionRow


@dataclass(frozen=True, slots=True)
class Unclaimed:
    """A record without a row, read."""

    file: RecordFile
    data: bytes | None  # None: it cannot be read
    record: MapRecord | None  # None: it is damaged
    sentence: str  # what is damaged; empty while it is whole


def without_row(bucket: Bucket, rows: list[VersionRow]) -> list[RecordFile]:
    """Records that these rows do not name."""
    named = {row.file for row in rows}
    return [file for file in record_files(bucket) if file not in named]


def newer(files: list[RecordFile], rows: list[VersionRow]) -> list[RecordFile]:
    """Records newer than every version of their map that has a row; older ones never count."""
    newest: dict[str, int] = {}
    for row in rows:
        newest[row.map_id] = max(row.number, newest.get(row.map_id, 0))
    return [file for file in files if file.number > newest.get(file.map_id, 0)]


def read_all(bucket: Bucket, files: list[RecordFile], notify: Notify) -> Iterator[Unclaimed]:
    """Read each; a single wrong bit is put right on the way."""
    for file in files:
        what = f"map {file.map_id}, version {file.number}"
        try:
            data = read_checked(bucket, file.name, file.address, what, notify)
            yield Unclaimed(file, data, decode_record(data, what), "")
        except Damaged as exc:
            try:
                left = bucket.get(file.name)
            except Unreadable:
                yield Unclaimed(file, None, None, str(exc))
                continue
            if left is not None:  # else a writer that failed took it away just now
                yield Unclaimed(file, left, None, str(exc))
