"""What a backup holds, listed in its last file: a wrong bit in tar's headers is put right by it, and a lack is told.

Every header of ours follows from a name, a size and what stands before it, so that the list says what it must be.
"""

from __future__ import annotations

import io
import tarfile
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO, cast

from shared.bounded import MAX_FILE_BYTES
from station.maps.address import ADDRESS, address_of, heal, is_whole, wrong_bits

FOLDER = "contents"
PIECE = 2048 * tarfile.BLOCKSIZE  # of a file that is looked through from its end
NUM_BITS = 8 * tarfile.BLOCKSIZE
_MAGIC = slice(257, 262)


@dataclass(frozen=True, slots=True)
class Listed:
    """One file of a backup."""

    offset: int  # of its header
    header: bytes
    size: int
    name: str

    @classmethod
    def behind(cls, before: Listed | None, name: str, size: int) -> Listed:
        info = tarfile.TarInfo(name)
        info.size = size
        return cls(0 if before is None else before.end, info.tobuf(tarfile.PAX_FORMAT), size, name)

    @property
    def end(self) -> int:
        return self.offset + len(self.header) + padded(self.size)


def padded(size: int) -> int:
    """Bytes that a file of this size takes in an archive."""
    return -(-size // tarfile.BLOCKSIZE) * tarfile.BLOCKSIZE


def is_list(name: str) -> bool:
    """Whether a file of an archive is the list."""
    folder, _, address = name.partition("/")
    return folder == FOLDER and ADDRESS.fullmatch(address) is not None


def encode(files: Sequence[Listed]) -> tuple[str, bytes]:
    """The list as a file: its name and what is in it."""
    data = "".join(f"{file.size} {file.name}\n" for file in files).encode()
    return f"{FOLDER}/{address_of(data)}", data


def read(file: BinaryIO) -> list[Listed]:
    """What was written into a backup, the list itself last; nothing where it has none (before November 2026 none had).

    Sought from the end, since what comes before may be damaged. Raises OSError.
    """
    size = file.seek(0, io.SEEK_END)
    for offset, block in _blocks_from_the_end(file, size):
        for member in _headers_like(block):
            # Behind the list there is nothing: what only looks like it, inside of a file, is passed over unread.
            begin = offset + tarfile.BLOCKSIZE
            if is_list(member.name) and 0 <= member.size <= MAX_FILE_BYTES and _is_end(file, begin, member.size, size):
                file.seek(begin)
                data = file.read(member.size)
                # The header was put right so that it fits; one wrong bit is all that is, so that the rest is whole.
                if member.tobuf(tarfile.USTAR_FORMAT) == block or is_whole(data, member.name.rpartition("/")[2]):
                    return decode(data, member.name)
    return []


def _blocks_from_the_end(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    at = size
    while at > 0:
        begin = (at - 1) // PIECE * PIECE
        file.seek(begin)
        piece = file.read(at - begin)
        for number in range((len(piece) - 1) // tarfile.BLOCKSIZE, -1, -1):
            offset = number * tarfile.BLOCKSIZE
            yield begin + offset, piece[offset : offset + tarfile.BLOCKSIZE]
        at = begin


def _headers_like(block: bytes) -> Iterator[tarfile.TarInfo]:
    """What a block says as the header of the list, as it is or with one bit put right."""
    begins = f"{FOLDER}/".encode()
    off = wrong_bits(block[: len(begins)], begins) + wrong_bits(block[_MAGIC], b"ustar")
    if len(block) != tarfile.BLOCKSIZE or off > 1:
        return
    as_number = int.from_bytes(block)
    for wrong in (0, *(1 << bit for bit in range(NUM_BITS))):
        try:
            yield tarfile.TarInfo.frombuf((as_number ^ wrong).to_bytes(tarfile.BLOCKSIZE), "utf-8", "surrogateescape")
        except tarfile.TarError:
            continue
        if not wrong:
            return


def _is_end(file: BinaryIO, begin: int, length: int, size: int) -> bool:
    """Whether an archive of `size` bytes ends with this file: two blocks of zeros are behind it, or up to a record."""
    end = begin + padded(length)
    if not 2 * tarfile.BLOCKSIZE <= size - end <= tarfile.RECORDSIZE + 2 * tarfile.BLOCKSIZE:
        return False
    file.seek(end)
    return int.from_bytes(file.read()).bit_count() <= 1


def decode(data: bytes, name: str) -> list[Listed]:
    """What the list with this name says, itself last; nothing where it is none."""
    address = name.rpartition("/")[2]
    right = data if is_whole(data, address) else heal(data, address)
    files: list[Listed] = []
    try:
        for line in () if right is None else right.decode().splitlines():
            length, _, one = line.partition(" ")
            if not 0 <= int(length) <= MAX_FILE_BYTES:
                return []
            files.append(Listed.behind(files[-1] if files else None, one, int(length)))
    except ValueError:  # somebody else's list
        return []
    return [*files, Listed.behind(files[-1], name, len(data))] if files else []


def with_right_headers(file: BinaryIO, files: Sequence[Listed]) -> tuple[BinaryIO, list[str]]:
    """The archive with every listed header in which one bit is wrong put right, and the names of those files."""
    wrong = []
    for listed in files:
        file.seek(listed.offset)
        if wrong_bits(file.read(len(listed.header)), listed.header) == 1:
            wrong.append(listed)
    file.seek(0)
    return cast(BinaryIO, _Patched(file, wrong)) if wrong else file, [listed.name for listed in wrong]


class _Patched:
    """What tarfile calls of a file that it only reads; some headers of it are replaced."""

    def __init__(self, file: BinaryIO, headers: Sequence[Listed]) -> None:
        """`headers`: in their order, none in another one."""
        self._file = file
        self._headers = headers
        self._offsets = [listed.offset for listed in headers]
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1, /) -> bytes:
        begin = self._file.tell()
        data = bytearray(self._file.read(size))
        end = begin + len(data)
        for listed in self._headers[max(0, bisect_right(self._offsets, begin) - 1) : bisect_right(self._offsets, end)]:
            first, last = max(listed.offset, begin), min(listed.offset + len(listed.header), end)
            if first < last:
                data[first - begin : last - begin] = listed.header[first - listed.offset : last - listed.offset]
        return bytes(data)
