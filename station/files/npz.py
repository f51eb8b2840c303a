"""Arrays in a zip file, as numpy's savez writes them; no length is believed, of the zip's table nor of an array."""

from __future__ import annotations

import contextlib
import math
import os
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from shared.bounded import Unpacking

# What damaged files raise; a RuntimeError (NotImplementedError is one) where a bit says "encrypted".
UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError)
_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # of the others some ask for gigabytes to unpack a byte


@dataclass(frozen=True, slots=True)
class ArrayHeader:
    """What an array says of itself. It has as many bytes as it says."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    in_columns: bool
    num_bytes: int


class Arrays:
    """The arrays of an open file, each read when it is asked for."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive

    @contextlib.contextmanager
    def open(self, name: str) -> Iterator[tuple[ArrayHeader, IO[bytes]]]:
        """An array's header, and its bytes to be read. Raises one of UNREADABLE."""
        member = self._archive.getinfo(f"{name}.npy")
        if member.compress_type not in _PACKINGS:
            raise ValueError(f"{name} is packed in a way that is not known")
        with self._archive.open(member) as file:
            yield _read_header(file, name, member.file_size), file

    def read(self, name: str) -> npt.NDArray[Any]:
        """An array, read-only. Raises one of UNREADABLE."""
        with self.open(name) as (header, file):
            return _read_values(file, name, header)


@contextlib.contextmanager
def open_arrays(file: IO[bytes]) -> Iterator[Arrays]:
    """The arrays of a .npz file. Raises one of UNREADABLE, also where they have more bytes than a file of its size."""
    unpacking = Unpacking(file.seek(0, os.SEEK_END))
    with zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            unpacking.take(member.file_size)
        yield Arrays(archive)


def read_array(file: IO[bytes]) -> npt.NDArray[Any]:
    """The array of a .npy file, read-only. Raises one of UNREADABLE."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    return _read_values(file, "the array", _read_header(file, "the array", size))


def _read_values(file: IO[bytes], name: str, header: ArrayHeader) -> npt.NDArray[Any]:
    data = file.read(header.num_bytes)
    if file.read(1):  # the checksum is compared at the end only
        raise ValueError(f"{name} is longer than it says")
    return np.frombuffer(data, header.dtype).reshape(header.shape, order="F" if header.in_columns else "C")


def _read_header(file: IO[bytes], name: str, num_bytes: int) -> ArrayHeader:
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError(f"{name} is of another format")
    try:
        shape, in_columns, dtype = np.lib.format.read_array_header_1_0(file)
    except (SyntaxError, tokenize.TokenError) as exc:  # what is no literal it reads once more, as a Python 2's
        raise ValueError(f"the header of {name} is none") from exc
    num_bytes -= file.tell()
    # Without bytes an array can have any length.
    if dtype.hasobject or not dtype.itemsize or math.prod(shape) * dtype.itemsize != num_bytes:
        raise ValueError(f"{name} does not have the bytes that it says")
    return ArrayHeader(shape, dtype, in_columns, num_bytes)
