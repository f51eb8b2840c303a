"""Reads a tar file that may be damaged: all of it that a sound header leads to, and how much of it none does."""

from __future__ import annotations

import os
import tarfile
from collections.abc import Callable, Iterator
from typing import BinaryIO, Self

from shared.bounded import MB, Refused, in_pieces
from station.maps.address import is_nearly

MAX_PIECE_BYTES = MB  # no header of ours has more
# Each is read anew up to where it is wrong, a megabyte at most: a stranger's file may be made of nothing else.
MAX_BROKEN_HEADERS = 100
END_BYTES = 2 * tarfile.BLOCKSIZE  # of zeros, in every archive


class DamagedArchive(tarfile.TarFile):
    """As tarfile's own, but what is no header is passed over: a wrong bit in one were taken for the end else."""

    def __init__(self, file: BinaryIO) -> None:
        self.num_bytes = file.seek(0, os.SEEK_END)
        self.num_broken = 0
        file.seek(0)
        pieces = in_pieces(file, MAX_PIECE_BYTES)
        super().__init__(fileobj=pieces, mode="r", ignore_zeros=True, tarinfo=_Header)


class _Header(tarfile.TarInfo):
    """A header of several blocks, as a long name has, that is damaged behind its first one is passed over, too.

    tarfile ends reading there, and everything behind it would be lost.
    """

    @classmethod
    def fromtarfile(cls, archive: tarfile.TarFile) -> Self:
        assert isinstance(archive, DamagedArchive)
        file = archive.fileobj
        assert file is not None
        begin = file.tell()
        try:
            found = super().fromtarfile(archive)
            holds_all = found.isreg() and not found.issparse()
            if found.size < 0 or (holds_all and found.offset_data + found.size > archive.num_bytes):
                raise ValueError("it leads out of the archive")
        except (tarfile.HeaderError, ValueError, OverflowError, Refused) as exc:
            if isinstance(exc, tarfile.HeaderError) and file.tell() <= begin + tarfile.BLOCKSIZE:
                raise  # of its first block: tarfile passes it over by itself
            archive.num_broken += 1
            if archive.num_broken > MAX_BROKEN_HEADERS:
                raise tarfile.ReadError(f"more than {MAX_BROKEN_HEADERS} headers in it are damaged") from exc
            archive.offset = begin
            file.seek(begin + tarfile.BLOCKSIZE)
            # What `next` goes on after, a block further. The types know only its base.
            raise tarfile.InvalidHeaderError(str(exc)) from exc  # type: ignore[attr-defined]
        return found


def members(archive: DamagedArchive, lost: Callable[[int, str], None]) -> Iterator[tarfile.TarInfo]:
    """What can be read of an archive; `lost` is told how many bytes cannot, and where.

    Raises ValueError: the end is missing.
    """
    end = 0
    while (member := archive.next()) is not None:
        if member.offset > end:
            lost(member.offset - end, f"before {member.name}")
        end = archive.offset
        yield member
    begin = _first_not_zero(archive, end)
    if begin is not None:
        lost(archive.num_bytes - begin, "at its end")
    if archive.num_bytes - end < END_BYTES or not _ends_with_zeros(archive):
        raise ValueError("its end is missing")


def _first_not_zero(archive: DamagedArchive, begin: int) -> int | None:
    """Where something comes from `begin` on, where an archive's end has nothing; one wrong bit is nothing."""
    file = archive.fileobj
    assert file is not None
    file.seek(begin)
    first, bits = None, 0
    while block := file.read(tarfile.BLOCKSIZE):
        if block.strip(b"\0"):
            first = begin if first is None else first
            bits += int.from_bytes(block).bit_count()
            if bits > 1:
                return first
        begin += len(block)
    return None


def _ends_with_zeros(archive: DamagedArchive) -> bool:
    file = archive.fileobj
    assert file is not None
    file.seek(archive.num_bytes - END_BYTES)
    return is_nearly(file.read(END_BYTES), bytes(END_BYTES))
