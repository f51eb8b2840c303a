"""A recording's bytes in order: its sound chunks, wherever they lie, and what is damaged between or behind them.

A damaged length or kind hides nothing: what every chunk says of its compression, always in the same place of its head,
is searched for, and the chunk's own checksum decides. Only chunks as recorder.py writes them are found.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE
from mcap.records import Chunk, McapRecord, Message

from shared.bounded import Unpacking
from shared.mcap_recording import DAMAGE
from shared.mcap_records import MAX_RECORD_BYTES, records_in

MAGIC = b"\x89MCAP0\r\n"  # at both ends of a finished file
COMPRESSION = b"\x03\0\0\0lz4"
WINDOW_BYTES = 1024 * 1024
_BEGIN = struct.Struct("<BQ")  # of every record: kind, length of what follows
_HEAD = struct.Struct("<BQQQQI")  # of a chunk: also first and last log time, size and checksum; then COMPRESSION
_LENGTH = struct.Struct("<Q")
_WITHOUT_MESSAGES = {
    Opcode.HEADER,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.MESSAGE_INDEX,
    Opcode.DATA_END,
    Opcode.CHUNK_INDEX,
    Opcode.STATISTICS,
    Opcode.SUMMARY_OFFSET,
    Opcode.FOOTER,
}


@dataclass(frozen=True, slots=True)
class SoundChunk:
    """A chunk that fits its checksum."""

    begin: int  # in the file; bytes
    end: int
    records: list[McapRecord]  # schemas, channels, messages


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes that may have held messages and cannot be read."""

    begin: int
    end: int
    is_cut: bool  # just a record that the file's end cuts off


@dataclass(slots=True)
class Survey:
    """What the parts of a recording come to."""

    messages: int = 0
    first_ns: int = 0
    last_ns: int = 0
    num_damaged: int = 0  # stretches
    bytes_damaged: int = 0
    bytes_cut: int = 0  # at the end

    @property
    def seconds(self) -> float:
        return (self.last_ns - self.first_ns) * 1e-9

    @property
    def inside(self) -> str:
        """What is damaged before the end, in words; empty: nothing."""
        if not self.num_damaged:
            return ""
        stretches = "1 damaged stretch" if self.num_damaged == 1 else f"{self.num_damaged} damaged stretches"
        return f"{stretches} inside it ({self.bytes_damaged / 1000:.1f} kB)"

    def add_message(self, message: Message) -> None:
        self.first_ns = min(self.first_ns, message.log_time) if self.messages else message.log_time
        self.last_ns = max(self.last_ns, message.log_time)
        self.messages += 1

    def add(self, part: SoundChunk | Damage) -> None:
        if isinstance(part, SoundChunk):
            for record in part.records:
                if isinstance(record, Message):
                    self.add_message(record)
        elif part.is_cut:
            self.bytes_cut += part.end - part.begin
        else:
            self.num_damaged += 1
            self.bytes_damaged += part.end - part.begin


def parts_of(file: BinaryIO) -> Iterator[SoundChunk | Damage]:
    """The parts in the order of the file, as long as it is now. Raises OSError when the disk does not give them."""
    size = file.seek(0, os.SEEK_END)
    end = 0  # of the last sound chunk
    for chunk in _sound_chunks(file, size):
        if (damage := _damage(file, end, chunk.begin, is_tail=False)) is not None:
            yield damage
        yield chunk
        end = chunk.end
    if (damage := _damage(file, end, size, is_tail=True)) is not None:
        yield damage


def has_end(file: BinaryIO) -> bool:
    """Whether the file ends as its writer ends it."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - FOOTER_SIZE - len(MAGIC)))
    end = file.read()
    begin = _BEGIN.pack(Opcode.FOOTER, FOOTER_SIZE - _BEGIN.size)
    return end.startswith(begin) and end[FOOTER_SIZE:] == MAGIC


def _sound_chunks(file: BinaryIO, size: int) -> Iterator[SoundChunk]:
    position, unpacking = _HEAD.size, Unpacking(size)
    while (found := _find(file, position, size)) is not None:
        chunk = _chunk(file, found - _HEAD.size, size, unpacking)
        if chunk is not None:
            yield chunk
        position = found + 1 if chunk is None else chunk.end + _HEAD.size


def _find(file: BinaryIO, position: int, size: int) -> int | None:
    while position < size:
        file.seek(position)
        window = file.read(WINDOW_BYTES + len(COMPRESSION) - 1)  # it may lie across the border of two
        if (index := window.find(COMPRESSION)) >= 0:
            return position + index
        position += WINDOW_BYTES
    return None


def _chunk(file: BinaryIO, begin: int, size: int, unpacking: Unpacking) -> SoundChunk | None:
    file.seek(begin)
    head = file.read(_HEAD.size + len(COMPRESSION) + _LENGTH.size)
    data_begin = begin + len(head)
    try:
        _, _, first_ns, last_ns, whole_size, checksum = _HEAD.unpack_from(head)
        (length,) = _LENGTH.unpack_from(head, _HEAD.size + len(COMPRESSION))
        if not checksum or length > min(size - data_begin, MAX_RECORD_BYTES):  # ours all have a checksum
            return None
        data = file.read(length)
        records = list(records_in(Chunk("lz4", data, last_ns, first_ns, checksum, whole_size), unpacking))
    except DAMAGE:
        return None
    return SoundChunk(begin, data_begin + length, records)


def _damage(file: BinaryIO, begin: int, end: int, *, is_tail: bool) -> Damage | None:
    """None when there are only whole records without messages: what a chunk stands between, and the file's end."""
    file.seek(max(0, end - len(MAGIC)))
    is_ended = file.read(len(MAGIC)) == MAGIC
    file.seek(0)
    position = len(MAGIC) if begin == 0 and file.read(len(MAGIC)) == MAGIC else begin
    while position < end:
        file.seek(position)
        head = file.read(min(_BEGIN.size, end - position))
        if is_tail and head == MAGIC:
            return None
        if len(head) < _BEGIN.size:
            return Damage(position, end, is_tail)
        kind, length = _BEGIN.unpack(head)
        after = position + len(head) + length
        if after > end:
            is_cut = is_tail and not is_ended and kind in {*_WITHOUT_MESSAGES, Opcode.CHUNK}
            return Damage(position, end, is_cut)
        if kind not in _WITHOUT_MESSAGES:
            return Damage(position, end, False)
        position = after
    return None
