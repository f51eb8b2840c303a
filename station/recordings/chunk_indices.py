"""The index of a recording while it is being made: on the disk, so that hours of it take no memory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from typing import Self

import msgspec
from mcap.records import ChunkIndex

from shared.disk import spill_folder

LENGTH_BYTES = 4


class ChunkIndices:
    """Stands where mcap's writer has a list: it appends an index per chunk, and reads them all when it finishes."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="sentinel-index-", dir=spill_folder())  # noqa: SIM115
        self._count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._count

    def append(self, index: ChunkIndex) -> None:
        content = msgspec.msgpack.encode(index)
        self._file.write(len(content).to_bytes(LENGTH_BYTES, "little") + content)
        self._count += 1

    def __iter__(self) -> Iterator[ChunkIndex]:
        self._file.seek(0)
        while length := self._file.read(LENGTH_BYTES):
            yield msgspec.msgpack.decode(self._file.read(int.from_bytes(length, "little")), type=ChunkIndex)
