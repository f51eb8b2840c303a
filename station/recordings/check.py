"""Whether a recording is what was written: chunks and index against their checksums, the count against its summary."""

from __future__ import annotations

import os
import shlex
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.reader import FOOTER_SIZE, make_reader
from mcap.records import Footer, Message

from shared.bounded import MB, in_pieces, open_file
from shared.mcap_recording import DAMAGE
from shared.mcap_records import MAX_RECORD_BYTES, bounded_records
from station.recordings.chunks import MAGIC, Survey, has_end, parts_of
from station.recordings.writer_lock import is_being_written


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """What a look at a recording found."""

    path: Path
    messages: int  # that can be read
    seconds: float
    bytes: int
    damage: str  # in words; empty: none
    is_being_written: bool = False  # it has no end yet, which is no damage

    def __str__(self) -> str:
        amount = f"{self.seconds:.1f} s, {self.messages} messages, {self.bytes / 1e6:.1f} MB"
        state = "is being written" if self.is_being_written else ""
        if not self.damage:
            return f"{self.path}: {state or 'whole'}, {amount}"
        said = f"{self.path}: {', '.join(filter(None, (state, self.damage)))}; readable: {amount}"
        if self.messages and not state:
            said += f"; `station recordings recover {shlex.quote(str(self.path))}` makes a proper file of these"
        return said


def check_recording(path: Path) -> RecordingCheck:
    """Read a recording from end to end. One that cannot be read at all is a finding too."""
    try:
        with open_file(path) as file:
            return check_file(path, file, is_being_written=is_being_written(file))
    except OSError as exc:
        return RecordingCheck(path, 0, 0.0, 0, f"cannot be read ({exc.strerror}); check its permissions and the disk")


def check_file(path: Path, file: BinaryIO, *, is_being_written: bool = False) -> RecordingCheck:
    """As `check_recording`, of a file that is open. Raises OSError."""
    size = file.seek(0, os.SEEK_END)
    is_ended = has_end(file)
    fault = ""
    if is_ended and not is_being_written:
        whole, fault = _read(file, size)
        if not fault:
            return RecordingCheck(path, whole.messages, whole.seconds, size, "")
    survey = Survey()
    for part in parts_of(file):
        survey.add(part)
    damage = survey.inside or fault
    if not survey.messages and not _begins_as_one(file):
        damage = "it is no recording: it neither begins as one nor has a part of one in it"
    elif not is_ended and not is_being_written:
        damage = "; ".join(filter(None, ("it has no end: its writer was killed, or the file was cut", damage)))
    return RecordingCheck(path, survey.messages, survey.seconds, size, damage, is_being_written)


def _begins_as_one(file: BinaryIO) -> bool:
    """Whether its first bytes are a recording's; of one that was cut right there as many as there are."""
    file.seek(0)
    return MAGIC.startswith(file.read(len(MAGIC)))


def _read(file: BinaryIO, size: int) -> tuple[Survey, str]:
    """What a file with an end holds, and what is wrong with it in words; empty: nothing."""
    found = Survey()
    try:
        if not _fits_index(file, size):
            return found, "its index is damaged"
        file.seek(0)
        summary = make_reader(in_pieces(file, MAX_RECORD_BYTES)).get_summary()
        for record in bounded_records(file):
            if isinstance(record, Message):
                found.add_message(record)
    except DAMAGE as exc:
        return found, f"damaged ({str(exc) or type(exc).__name__})"
    statistics = None if summary is None else summary.statistics
    if statistics is not None and found.messages != statistics.message_count:
        return found, f"damaged ({found.messages} of {statistics.message_count} messages are found)"
    return found, ""


def _fits_index(file: BinaryIO, size: int) -> bool:
    """Whether the file's last part, with the index of its chunks, fits its checksum; a writer may give none."""
    footer_begin = size - FOOTER_SIZE - len(MAGIC)
    file.seek(footer_begin + 9)  # behind kind and length
    footer = Footer.read(ReadDataStream(file))
    if not footer.summary_crc:
        return True
    begin = footer.summary_start or footer_begin
    file.seek(begin)
    checksum, left = 0, size - len(MAGIC) - 4 - begin  # without the checksum itself
    while left > 0 and (piece := file.read(min(left, MB))):
        checksum, left = zlib.crc32(piece, checksum), left - len(piece)
    return checksum == footer.summary_crc
