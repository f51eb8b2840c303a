"""A recording that was cut or damaged: what is sound in it becomes a proper file again, under its own name."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.reader import make_reader
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.writer import CompressionType, Writer

from shared.bounded import in_pieces, open_file
from shared.disk import replacing
from shared.errors import DataError
from shared.mcap_recording import DAMAGE
from shared.mcap_records import MAX_RECORD_BYTES
from station.recordings.check import check_file
from station.recordings.chunks import SoundChunk, Survey, parts_of
from station.recordings.topics import LIBRARY, register_channels
from station.recordings.writer_lock import hold


@dataclass(frozen=True, slots=True)
class Recovery:
    """What could be had of a cut or damaged file."""

    path: Path
    messages: int
    seconds: float  # of recording
    inside: str  # what was passed over before the end, in words; empty: nothing
    bytes_cut: int  # a record that the file's end cut off
    original: Path | None  # the file as it was, when something was passed over

    def __str__(self) -> str:
        said = f"{self.path}: {self.seconds:.1f} s of the recording were recovered ({self.messages} messages)"
        if self.bytes_cut:
            said += f"; {self.bytes_cut / 1000:.1f} kB at its end were cut off"
        if self.inside:
            said += f"; {self.inside} could not be read"
        if self.original is not None:
            said += f"; the file as it was is kept as {self.original}"
        return said


def recover_recording(path: Path) -> Recovery | None:
    """Write a cut or damaged recording anew; it takes the old one's name when it is whole. None: nothing is wrong.

    The old file is kept beside it when more than a cut end was lost.

    Raises:
        DataError: it is being recorded, nothing in it can be used, the disk fails or has no space for the copy (the
            old file stays as it is).
    """
    scratch = path.with_name(f".{path.name}.recovered")
    try:
        with open_file(path, for_writing=True) as source:  # nothing is written; some network disks lock no other file
            if not hold(source):
                raise DataError(f"{path} is being recorded; end that, then it needs no recovery")
            if not check_file(path, source).damage:
                return None
            with replacing(path, scratch=scratch) as target:
                survey = _copy(source, target, path)
                if not survey.messages:
                    raise DataError(f"{path} holds nothing that can be recovered; it stays as it is")
                target.flush()
                os.fsync(target.fileno())  # before the old one gets a second name
                original = _name_twice(path) if survey.num_damaged else None
    except OSError as exc:
        raise DataError(f"{path} cannot be recovered ({exc.strerror}); look at the disk and its free space") from exc
    return Recovery(path, survey.messages, survey.seconds, survey.inside, survey.bytes_cut, original)


def _name_twice(path: Path) -> Path:
    """Give the file a second name, which nothing has yet."""
    second, number = path.with_name(f"{path.name}.damaged"), 1
    while True:
        try:
            os.link(path, second)
            return second
        except FileExistsError:
            number += 1
            second = path.with_name(f"{path.name}.damaged.{number}")


def _copy(source: BinaryIO, target: BinaryIO, path: Path) -> Survey:
    """Write what is sound in one file into another. Raises DataError."""
    writer = Writer(target, chunk_size=512 * 1024, compression=CompressionType.LZ4)
    library = _library(source)
    writer.start(profile="", library=library)
    copy = _Copy(writer, path, is_ours=library == LIBRARY)
    survey = Survey()
    for part in parts_of(source):
        survey.add(part)
        if isinstance(part, SoundChunk):
            for record in part.records:
                copy.add(record)
        else:
            copy.note_hole()
    finish: Callable[[], None] = writer.finish  # mcap leaves it untyped
    finish()
    return survey


def _library(source: BinaryIO) -> str:
    """What wrote a recording; ours where that cannot be read."""
    try:
        source.seek(0)
        return make_reader(in_pieces(source, MAX_RECORD_BYTES)).get_header().library
    except DAMAGE:
        return LIBRARY


class _Copy:
    """Channels keep their numbers: those of our own files are the same in each, for when their first chunk is lost."""

    def __init__(self, writer: Writer, path: Path, *, is_ours: bool) -> None:
        self._writer, self._path = writer, path
        self._by_topic = register_channels(writer) if is_ours else {}
        self._channels = {number: number for number in self._by_topic.values()}  # there → here
        self._schemas: dict[int, Schema] = {}
        self._is_behind_hole = False

    def note_hole(self) -> None:
        self._is_behind_hole = True

    def add(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._add_channel(record)
        elif isinstance(record, Message):
            if record.channel_id not in self._channels:
                raise DataError(
                    f"{self._path} is another program's, and what names its channels is lost; it stays as it is"
                )
            self._writer.add_message(
                self._channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                # The count begins anew behind a hole, or reading would end there (shared/mcap_recording.py).
                0 if self._is_behind_hole else record.sequence,
            )
            self._is_behind_hole = False

    def _add_channel(self, channel: Channel) -> None:
        if channel.topic not in self._by_topic:
            schema = self._schemas.get(channel.schema_id)
            number = self._writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            self._by_topic[channel.topic] = self._writer.register_channel(
                channel.topic, channel.message_encoding, number
            )
        self._channels[channel.id] = self._by_topic[channel.topic]
