"""What a backup holds, listed in its last file: a wrong bit in tar's headers is put right by it, and a lack is told.

Every header of ours follows from a name, a size and the place where it stands, so that the list says what it must be.
"""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterable
from dataclasses import dataclass
from typing import BinaryIO, cast

from shared.bounded import MAX_FILE_BYTES
from station.maps.address import ADDRESS, address_of, heal, is_whole

FOLDER = "contents"
BEGIN = f"{FOLDER}/".encode()
PIECE = 2048 * tarfile.BLOCKSIZE
MAX_FILE_OFFSET = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Listed:
    """One file of a backup."""

    offset: int  # of its header
    size: int
    name: str

    @property
    def info(self) -> tarfile.TarInfo:
        info = tarfile.TarInfo(self.name)
        info.size = self.size
        return info

    @property
    def header(self) -> bytes:
        return self.info.tobuf(tarfile.PAX_FORMAT)

    @property
    def end(self) -> int:
        return self.offset + len(self.header) + -(-self.size // tarfile.BLOCKSIZE) * tarfile.BLOCKSIZE


def encode(files: Iterable[Listed]) -> tuple[str, bytes]:
    """The list as a file: its name and what is in it."""
    data = "".join(f"{file.offset} {file.size} {file.name}\n" for file in files).encode()
    return f"{FOLDER}/{address_of(data)}", data


def read(file: BinaryIO) -> list[Listed]:
    """What was written into a backup; nothing where it does not say so (before November 2026 none did).

    Sought from the end, since what comes before may be damaged. Raises OSError.
    """
    block, at = tarfile.BLOCKSIZE, file.seek(0, io.SEEK_END)
    piece = b""
    while at > 0:
        begin = max(0, (at - 1) // PIECE * PIECE)
        file.seek(begin)
        piece = file.read(at - begin)
        for number in range((len(piece) - 1) // block, -1, -1):
            if piece.startswith(BEGIN, block * number) and (found := _read_at(file, begin + block * number)):
                return found
        at = begin
    return []


def _read_at(file: BinaryIO, offset: int) -> list[Listed]:
    file.seek(offset)
    try:
        member = tarfile.TarInfo.frombuf(file.read(tarfile.BLOCKSIZE), "utf-8", "surrogateescape")
        address = member.name.removeprefix(f"{FOLDER}/")
        if not ADDRESS.fullmatch(address) or not 0 <= member.size <= MAX_FILE_BYTES:
            return []
        data = file.read(member.size)
        right = data if is_whole(data, address) else heal(data, address)
        return [] if right is None else [_listed(line) for line in right.decode().splitlines()]
    except (tarfile.TarError, ValueError):  # it only looks like one
        return []


def _listed(line: str) -> Listed:
    offset, size, name = line.split(" ", 2)
    listed = Listed(int(offset), int(size), name)
    if not (0 <= listed.offset <= MAX_FILE_OFFSET and 0 <= listed.size <= MAX_FILE_BYTES):
        raise ValueError("it lists what lies nowhere")
    return listed


def with_right_headers(file: BinaryIO, files: Iterable[Listed]) -> tuple[BinaryIO, list[str]]:
    """The archive with every listed header in which one bit is wrong put right, and the names of those files."""
    blocks, names = {}, []
    for listed in files:
        file.seek(listed.offset)
        wanted = listed.header
        found = file.read(len(wanted))
        if len(found) == len(wanted) and (int.from_bytes(found) ^ int.from_bytes(wanted)).bit_count() == 1:
            blocks[listed.offset] = wanted
            names.append(listed.name)
    file.seek(0)
    return cast(BinaryIO, _Patched(file, blocks)) if blocks else file, names


class _Patched:
    """What tarfile calls of a file that it only reads; some pieces of it are replaced."""

    def __init__(self, file: BinaryIO, pieces: dict[int, bytes]) -> None:
        self._file = file
        self._pieces = pieces
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1, /) -> bytes:
        begin = self._file.tell()
        data = io.BytesIO(self._file.read(size))
        length = len(data.getbuffer())
        for at, piece in self._pieces.items():
            first, last = max(at, begin), min(at + len(piece), begin + length)
            if first < last:
                data.seek(first - begin)
                data.write(piece[first - at : last - at])
        return data.getvalue()
