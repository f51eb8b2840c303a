"""Records as files: the name of each says of which version of which map it is, and what bytes it must hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from station.maps.address import ADDRESS
from station.maps.bucket import Bucket

FOLDER = "records"
ASIDE = "damaged"  # the folder of records that repair gave up
_NAME = re.compile(
    r"(?P<map>[A-Za-z0-9][A-Za-z0-9_-]{0,99})\.(?P<number>\d{6}|[1-9]\d{6,})\."
    rf"(?P<address>{ADDRESS.pattern})"
)


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A record by its name: what a lost index is made from again."""

    map_id: str
    number: int  # of the version
    address: str
    folder: str = FOLDER

    @property
    def name(self) -> str:
        """In the bucket."""
        return f"{self.folder}/{self.map_id}.{self.number:06d}.{self.address}"


def parse_record_name(name: str, folder: str = FOLDER) -> RecordFile | None:
    """None for a file that is no record, such as what a killed writer left half-written."""
    match = _NAME.fullmatch(name.removeprefix(f"{folder}/"))
    return None if match is None else RecordFile(match["map"], int(match["number"]), match["address"], folder)


def record_files(bucket: Bucket, folder: str = FOLDER) -> Iterator[RecordFile]:
    """All records, or those that were set aside."""
    for name, _ in bucket.names(folder):
        if (file := parse_record_name(name, folder)) is not None:
            yield file
