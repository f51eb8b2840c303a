"""Files that somebody else may have made: what is opened, how far it may unpack, and what is said otherwise.

What is not read raises `Refused`, an OSError whose `strerror` says why: who reads a file has a sentence for the errors
of the disk already, with the file's name and the remedy.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
import tomllib
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

MB = 1024 * 1024
MAX_TEXT_BYTES = MB // 4  # of a calibration or a matrix; YAML takes seconds for more
MAX_SETTINGS_BYTES = MB
MAX_JSON_BYTES = 64 * MB  # a record of a map lists every landmark of every place
MAX_PICTURE_BYTES = 64 * MB
MAX_FILE_BYTES = 1024 * MB  # that is read at once: clouds, observations
MAX_LINE_BYTES = 64 * 1024
# A recording of an IMU alone packs eight times, pictures not at all. The first bytes are free: a file of zeros is no
# danger while it is small.
MAX_RATIO = 32
FREE_BYTES = 32 * MB
SHOWN_CHARACTERS = 200  # the longest name of ours, a record's of a map with a long id, has 190
MAX_KEY_PARTS = 32  # of TOML; our files have four

_KINDS = {
    stat.S_IFIFO: "it is a pipe, no file",
    stat.S_IFCHR: "it is a device, no file",
    stat.S_IFBLK: "it is a device, no file",
}


class Refused(OSError):
    """A file is not read, for what it is."""

    def __init__(self, why: str, path: Path | None = None) -> None:
        super().__init__(errno.EFBIG, why, path)

    def __str__(self) -> str:
        return str(self.strerror)


def open_file(path: Path, *, for_writing: bool = False) -> BufferedReader:
    """A regular file, to be read; `for_writing`, so that it can also be locked on network disks.

    A pipe would be waited for without end, a device may give bytes without end.

    Raises:
        OSError: as open() does; Refused where it is something else.
    """
    access = os.O_RDWR if for_writing else os.O_RDONLY
    descriptor = os.open(path, access | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
        raise Refused(_KINDS.get(stat.S_IFMT(mode), "it is no regular file"), path)
    return os.fdopen(descriptor, "rb")


def read_file(path: Path, max_bytes: int) -> bytes:
    """All of a file. Raises OSError; Refused where it has more than `max_bytes`."""
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise Refused(f"it has {_megabytes(size)}, more than the {_megabytes(max_bytes)} that are read", path)
        return file.read(size)


def read_text(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """As read_file, of text. Raises UnicodeDecodeError, which is a ValueError, where it is none."""
    return read_file(path, max_bytes).decode("utf-8")


def in_pieces(file: IO[bytes], max_bytes: int) -> BinaryIO:
    """A file for libraries that believe every length they find in it: Refused where a piece is larger than that."""
    return cast(BinaryIO, _InPieces(file, max_bytes))


class _InPieces:
    """What libraries call of a file that they only read."""

    def __init__(self, file: IO[bytes], max_bytes: int) -> None:
        self._file = file
        self._max_bytes = max_bytes
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1, /) -> bytes:
        """Raises Refused."""
        if not 0 <= size <= self._max_bytes:
            raise Refused(f"a part of it claims {shown(size)} bytes, more than the {self._max_bytes} that are read")
        return self._file.read(size)


class Unpacking:
    """How far a packed file may still unpack, whatever the lengths in it say."""

    def __init__(self, packed_bytes: int) -> None:
        self._allowed = self._left = FREE_BYTES + MAX_RATIO * packed_bytes

    def take(self, size: int) -> None:
        """Before `size` bytes are unpacked. Raises Refused."""
        self._left -= size
        if self._left < 0:
            raise Refused(f"it unpacks to more than {_megabytes(self._allowed)}, which is too much for its size")


# Of a dotted key, at its beginning: tomllib notes for each part all those before it, which of 16,000 fills a gigabyte.
_LONG_KEY = re.compile(
    rf"""(?<![\w"'\\-])(?:(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')\s*+\.\s*+){{{MAX_KEY_PARTS}}}"""
)


def parse_json(text: str | bytes) -> Any:
    """As json.loads. Raises ValueError, also where it nests too deep."""
    try:
        return json.loads(text)
    except RecursionError as exc:
        raise ValueError("it nests too deep") from exc


def parse_toml(text: str) -> dict[str, Any]:
    """As tomllib.loads. Raises ValueError, also where it nests too deep."""
    if _LONG_KEY.search(text):
        raise ValueError(f"a dotted name in it has more than {MAX_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError as exc:
        raise ValueError("it nests too deep") from exc


def shown(value: object) -> str:
    """A value out of a file, as a message shows it: not the whole file, nor a number of a million digits."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4300 digits
        text = f"a {type(value).__name__} too long to write"
    return shortened(text)


def shortened(text: str) -> str:
    """As much of a text as a message shows."""
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[:SHOWN_CHARACTERS]}…"


def _megabytes(size: int) -> str:
    return f"{size / MB:.1f} MB" if size < 100 * MB else f"{size // MB} MB"
