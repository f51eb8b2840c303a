"""Arrays that wait on the disk, in files without names, until the navigation that they belong to ends."""

from __future__ import annotations

import contextlib
import errno
import logging
import mmap
import os
import shutil
import tempfile
from collections.abc import Sequence
from typing import TypeVar, overload

import numpy as np
import numpy.typing as npt

from shared.disk import spill_folder

logger = logging.getLogger(__name__)
A = TypeVar("A", bound=np.generic)
FILE_BYTES = 64 * 1024 * 1024  # some 250 keyframes; each file costs a file descriptor
RESIDENT_BYTES = 8 * 1024 * 1024  # what stays in memory
ALIGNED = 64  # as numpy's own arrays
KEPT_FREE_BYTES = 1024 * 1024 * 1024  # more than a recording asks for: this must not be what ends it


class Spill:
    """Takes arrays and gives read-only ones with the same bits back, which take no memory while nobody looks at them.

    A navigation of an hour has gigabytes of features, of which only the last few are looked at before it ends. Where
    the disk is full, or there is none, they stay in memory.
    """

    def __init__(self, file_bytes: int = FILE_BYTES, resident_bytes: int = RESIDENT_BYTES) -> None:
        self._file_bytes = file_bytes
        self._resident_bytes = resident_bytes
        self._chunk: mmap.mmap | None = None
        self._used = 0  # of the chunk
        self._resident = 0
        self._is_full = False

    def put(self, array: npt.NDArray[A]) -> npt.NDArray[A]:
        """The same array, mapped from a file."""
        if not array.nbytes or self._is_full:
            return array
        chunk = self._room_for(array.nbytes)
        if chunk is None:
            return array
        view = np.frombuffer(chunk, array.dtype, array.size, self._used).reshape(array.shape)
        view[...] = array
        view.flags.writeable = False
        size = -(-array.nbytes // ALIGNED) * ALIGNED
        self._used += size
        self._resident += size
        if self._resident > self._resident_bytes:
            self._give_back(chunk)
        return view

    def _room_for(self, size: int) -> mmap.mmap | None:
        if self._chunk is None or self._used + size > len(self._chunk):
            if self._chunk is not None:
                self._give_back(self._chunk)
            try:
                self._chunk, self._used = _map_file(max(size, self._file_bytes)), 0
            except OSError as exc:
                self._is_full = True
                logger.warning("the disk has no room for arrays (%s); they stay in memory", exc.strerror)
                return None
        return self._chunk

    def _give_back(self, chunk: mmap.mmap) -> None:
        """Its memory, to the system: who reads an array in it later gets it from the disk."""
        self._resident = 0
        if hasattr(mmap, "MADV_DONTNEED"):
            with contextlib.suppress(OSError):
                chunk.madvise(mmap.MADV_DONTNEED)


class SpilledFiles(Sequence[bytes]):
    """Files, such as pictures, in spilled arrays."""

    def __init__(self, spill: Spill) -> None:
        self._spill = spill
        self._files: list[npt.NDArray[np.uint8]] = []

    def append(self, file: bytes) -> None:
        self._files.append(self._spill.put(np.frombuffer(file, np.uint8)))

    def __len__(self) -> int:
        return len(self._files)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> list[bytes]: ...
    def __getitem__(self, index: int | slice) -> bytes | list[bytes]:
        if isinstance(index, slice):
            return [file.tobytes() for file in self._files[index]]
        return self._files[index].tobytes()


def _map_file(size: int) -> mmap.mmap:
    """Raises OSError when there is no room for it: found out later, touching it would end the process."""
    folder = spill_folder()
    if shutil.disk_usage(folder).free < size + KEPT_FREE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with tempfile.TemporaryFile(prefix="sentinel-", buffering=0, dir=folder) as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
        elif file.write(bytes(size)) != size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return mmap.mmap(file.fileno(), size)  # it keeps the file
