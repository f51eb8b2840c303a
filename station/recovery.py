"""A recording whose writer was killed: what is whole in it becomes a proper file again, under its own name."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from shared.errors import DataError
from shared.mcap_recording import DAMAGE, MAX_RECORD_BYTES

MAGIC = b"\x89MCAP0\r\n"  # at both ends of a finished file


@dataclass(frozen=True, slots=True)
class Recovery:
    """What could be had of a cut file."""

    path: Path
    messages: int
    seconds: float  # of recording
    bytes_lost: int  # behind the last whole chunk

    def __str__(self) -> str:
        lost = f"; {self.bytes_lost / 1000:.0f} kB at its end were cut off" if self.bytes_lost else ""
        return f"{self.path}: {self.seconds:.1f} s of the recording were recovered ({self.messages} messages){lost}"


def is_finished(path: Path) -> bool:
    """Whether a recording has its end: index and footer."""
    try:
        with path.open("rb") as file:
            if file.seek(0, os.SEEK_END) < 2 * len(MAGIC):
                return False
            file.seek(-len(MAGIC), os.SEEK_END)
            if file.read() != MAGIC:
                return False
            file.seek(0)
            return make_reader(file).get_summary() is not None
    except DAMAGE:
        return False
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); check its permissions") from exc


def recover_recording(path: Path) -> Recovery | None:
    """Write a cut recording anew, with its end; it takes the old one's name when it is whole. None: it has its end.

    Raises:
        DataError: nothing in it can be used, or there is no space for the copy (the old file stays as it is).
    """
    if is_finished(path):
        return None
    scratch = path.with_name(f".{path.name}.recovered")
    try:
        with path.open("rb") as source, scratch.open("wb") as target:
            messages, first_ns, last_ns, read_to = _copy(source, target)
            target.flush()
            os.fsync(target.fileno())
        if not messages:
            raise DataError(f"{path} holds nothing that can be recovered; delete it")
        lost = max(0, path.stat().st_size - read_to)
        os.replace(scratch, path)
    except OSError as exc:
        raise DataError(f"{path} cannot be recovered ({exc.strerror}); free space and start again") from exc
    finally:
        scratch.unlink(missing_ok=True)
    return Recovery(path, messages, (last_ns - first_ns) * 1e-9, lost)


def _copy(source: BinaryIO, target: BinaryIO) -> tuple[int, int, int, int]:
    """Messages copied, first and last log time, and the position behind the last chunk that was whole."""
    writer = Writer(target, chunk_size=512 * 1024, compression=CompressionType.LZ4)
    writer.start(profile="", library="sentinel-robot")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    messages, first_ns, last_ns, read_to = 0, 0, 0, 0
    try:
        for record in StreamReader(source, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES).records:
            if isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                schema = schemas.get(record.schema_id, 0)
                channels[record.id] = writer.register_channel(record.topic, record.message_encoding, schema)
            elif isinstance(record, Message) and record.channel_id in channels:
                writer.add_message(
                    channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
                )
                first_ns = record.log_time if not messages else min(first_ns, record.log_time)
                last_ns = max(last_ns, record.log_time)
                messages += 1
                read_to = source.tell()
    except DAMAGE:
        pass  # the file ends here
    writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it untyped
    return messages, first_ns, last_ns, read_to
