"""The records of an MCAP file, one after the other, whatever its lengths and chunks claim.

The library's own reader unpacks a chunk as far as it goes: 164 kB of zstd to 5 GB.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import IO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import CRCValidationError, StreamReader

from shared.bounded import MB, Refused, Unpacking, in_pieces

MAX_RECORD_BYTES = 32 * MB  # also of an unpacked chunk: the recorder's have half of one, and one picture


def bounded_records(file: IO[bytes]) -> Iterator[McapRecord]:
    """All records from the file's begin on, those in chunks too; checksums are compared.

    Raises:
        Refused: a record, a chunk or the whole unpacks to more than any recording does.
        One of mcap_recording.DAMAGE otherwise.
    """
    unpacking = Unpacking(file.seek(0, os.SEEK_END))
    file.seek(0)
    reader = StreamReader(
        in_pieces(file, MAX_RECORD_BYTES), emit_chunks=True, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES
    )
    for record in reader.records:
        if isinstance(record, Chunk):
            yield from records_in(record, unpacking)
        else:
            yield record


def records_in(chunk: Chunk, unpacking: Unpacking) -> Iterator[McapRecord]:
    """Schemas, channels and messages of a chunk. Raises as bounded_records does."""
    data = _unpacked(chunk, unpacking)
    if chunk.uncompressed_crc not in (0, checksum := zlib.crc32(data)):
        raise CRCValidationError(chunk.uncompressed_crc, checksum, chunk)
    stream = ReadDataStream(BytesIO(data))
    while stream.count < len(data):
        kind, length = stream.read1(), stream.read8()
        if length > len(data) - stream.count:
            raise ValueError(f"a record of a chunk claims {length} bytes, more than the chunk holds")
        if kind == Opcode.MESSAGE:
            yield Message.read(stream, length)
        elif kind == Opcode.CHANNEL:
            yield Channel.read(stream)
        elif kind == Opcode.SCHEMA:
            yield Schema.read(stream)
        else:
            stream.read(length)


def _unpacked(chunk: Chunk, unpacking: Unpacking) -> bytes:
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise Refused(f"a chunk of it claims {size} bytes, more than the {MAX_RECORD_BYTES} that are unpacked")
    unpacking.take(size)
    if chunk.compression == "lz4":
        unpacker = lz4.frame.LZ4FrameDecompressor()
        data: bytes = unpacker.decompress(chunk.data, max_length=size + 1)
        # What follows them belongs to the next chunks: the length is damaged, and trusted it would hide those.
        if not unpacker.eof or unpacker.unused_data:
            raise ValueError("a chunk's packed bytes end too soon, or go on after the size it claims")
    elif chunk.compression == "zstd":
        packed = zstandard.ZstdDecompressor(max_window_size=MAX_RECORD_BYTES)
        with packed.stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)
    elif chunk.compression:
        raise ValueError(f"a chunk is packed as {chunk.compression[:20]!r}, which is not known")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(f"a chunk does not unpack to the {size} bytes it claims")
    return data
