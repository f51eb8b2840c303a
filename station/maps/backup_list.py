"""What a backup holds, listed in its last file: a wrong bit in tar's headers is put right by it, and a lack is told.

Every header of ours follows from a name, a size and what stands before it, so that the list says what it must be.
"""

from __future__ import annotations

import io
import re
import tarfile
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO, cast

from shared.bounded import MAX_FILE_BYTES
from station.maps.address import ADDRESS, ADDRESS_LENGTH, address_of, heal, is_nearly, is_whole

FOLDER = "contents"
PIECE = 2048 * tarfile.BLOCKSIZE  # of a file that is looked through from its end
_BEGINS = f"{FOLDER}/".encode()
# Fields of a header, https://pubs.opengroup.org/onlinepubs/9699919799/utilities/pax.html#tag_20_92_13_06
_SIZE, _MAGIC = slice(124, 136), slice(257, 262)
_OCTAL = re.compile(rb"[0-7]{11}\0")
_MAX_END_BYTES = tarfile.RECORDSIZE + 2 * tarfile.BLOCKSIZE


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


@dataclass(frozen=True, slots=True)
class BackupList:
    """The list of a backup, as it was read there."""

    offset: int  # of its header, where it was found
    name: str
    data: bytes  # put right, and each of its lines is one of ours

    def names(self) -> Iterator[str]:
        """Of the files before it."""
        return (name for name, _ in _entries(self.data))

    def files(self) -> Iterator[Listed]:
        """Every file with its header, itself last; none from where it lies on: what was in between is not all there."""
        before = None
        for name, size in (*_entries(self.data), (self.name, len(self.data))):
            before = Listed.behind(before, name, size)
            if before.offset > self.offset:
                return
            yield before

    @property
    def is_in_place(self) -> bool:
        """Whether it lies where its own lines put it; else something was taken out, put in, or is not as it says."""
        last = None
        for last in self.files():  # noqa: B007
            pass
        return last is not None and (last.offset, last.name) == (self.offset, self.name)


def encode(files: Sequence[Listed]) -> tuple[str, bytes]:
    """The list as a file: its name and what is in it."""
    data = "".join(f"{file.size} {file.name}\n" for file in files).encode()
    return f"{FOLDER}/{address_of(data)}", data


def decode(data: bytes, name: str, offset: int) -> BackupList | None:
    """The list of this name whose header is at `offset`; None where it is damaged, or none of ours."""
    address = name.rpartition("/")[2]
    right = data if is_whole(data, address) else heal(data, address)
    if right is None:
        return None
    try:
        count = 0
        for _, size in _entries(right):
            count += 1
            if not 0 <= size <= MAX_FILE_BYTES:
                return None
    except ValueError:
        return None
    return BackupList(offset, name, right) if count else None


def _entries(data: bytes) -> Iterator[tuple[str, int]]:
    """Name and size of each file, one after another: of many lines none is kept. Raises ValueError."""
    for line in io.BytesIO(data):
        size, _, name = line.decode().removesuffix("\n").partition(" ")
        yield name, int(size)


def read(file: BinaryIO) -> BackupList | None:
    """What was written into a backup; None where it has no list (before 29 November 2026 none had).

    Sought from the end, since what comes before may be damaged. Raises OSError.
    """
    size = file.seek(0, io.SEEK_END)
    for offset, block in _blocks_from_the_end(file, size):
        if not _looks_like_header(block):
            continue
        begin = offset + tarfile.BLOCKSIZE
        lengths = [length for length in _lengths_in(block) if _is_end(file, begin, length, size)]
        if lengths:
            # Behind the list there is nothing, so that only one file can be it: a file of a stranger, made of what
            # looks like lists, is not hashed for each of them.
            return _read_at(file, offset, block, lengths)
    return None


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


def _looks_like_header(block: bytes) -> bool:
    """Whether a block may be the list's header with one wrong bit: at a first look, since every block is looked at."""
    is_block = len(block) == tarfile.BLOCKSIZE
    return is_block and is_nearly(block[: len(_BEGINS)], _BEGINS) and is_nearly(block[_MAGIC], b"ustar")


def _lengths_in(block: bytes) -> Iterator[int]:
    """How long a header says that its file is, as it stands there and with any one bit of that put right."""
    field = int.from_bytes(block[_SIZE])
    for wrong in (0, *(1 << bit for bit in range(8 * (_SIZE.stop - _SIZE.start)))):
        digits = (field ^ wrong).to_bytes(_SIZE.stop - _SIZE.start)
        if _OCTAL.fullmatch(digits):
            yield int(digits[:-1], 8)


def _is_end(file: BinaryIO, begin: int, length: int, size: int) -> bool:
    """Whether an archive of `size` bytes ends with this file: two blocks of zeros are behind it, or up to a record.

    One bit of them may be wrong.
    """
    end = begin + padded(length)
    if length > MAX_FILE_BYTES or not 2 * tarfile.BLOCKSIZE <= size - end <= _MAX_END_BYTES:
        return False
    file.seek(end)
    return int.from_bytes(file.read()).bit_count() <= 1


def _read_at(file: BinaryIO, offset: int, block: bytes, lengths: Sequence[int]) -> BackupList | None:
    """The list whose header this block is, or is but for one bit; `lengths` are those that the file may have."""
    said = block[:100].rstrip(b"\0").decode("ascii", "replace")
    for length in lengths:
        # Which length it is tell the header's own checksum and, where the wrong bit is in the name, the content.
        is_right = is_list(said) and is_nearly(block, _header(said, length))
        if not is_right and length != lengths[0]:
            continue
        file.seek(offset + tarfile.BLOCKSIZE)
        data = file.read(length)
        if is_right and (found := decode(data, said, offset)) is not None:
            return found
        name = f"{FOLDER}/{address_of(data)}"
        if is_nearly(block, _header(name, length)):
            return decode(data, name, offset)
    return None


def _header(name: str, size: int) -> bytes:
    return Listed.behind(None, name, size).header


def with_right_headers(file: BinaryIO, found: BackupList) -> tuple[BinaryIO, list[str]]:
    """The archive with every listed header that is damaged put right, and the names of those files.

    How much of a header is wrong does not matter where the content behind it has the checksum of its name.
    """
    wrong = []
    for listed in found.files() if found.is_in_place else ():
        file.seek(listed.offset)
        there = file.read(len(listed.header))
        if there != listed.header and (is_nearly(there, listed.header) or _is_there(file, listed)):
            wrong.append(listed)
    file.seek(0)
    return cast(BinaryIO, _Patched(file, wrong)) if wrong else file, [listed.name for listed in wrong]


def _is_there(file: BinaryIO, listed: Listed) -> bool:
    """Whether a listed file comes next, as its name says by its checksum.

    In an archive that somebody packed anew in another order other files do, under headers of their own.
    """
    address = listed.name[-ADDRESS_LENGTH:]
    return ADDRESS.fullmatch(address) is not None and is_whole(file.read(listed.size), address)


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
