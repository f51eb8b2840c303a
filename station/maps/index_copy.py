"""A map store in a folder that takes no writes (a failing disk, another user's): a copy of its index is looked at.

SQLite must undo a transaction that was cut before anybody may read, and a record without a row needs one. Where
neither can be written both happen in the copy: it lies in a private folder of its own, and is gone when its store is.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
import weakref
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO

from shared.disk import lock
from station.files.unwritable import Unwritable, cannot_write, why_unwritable
from station.maps.bucket import Bucket, FolderBucket, Unreadable
from station.maps.contents import Contents
from station.maps.database import Database

PREFIX = "sentinel-maps-"
IN_USE = "in-use"  # locked as long as its owner lives
FORGOTTEN_S = 60.0  # a folder that is being made is not locked yet
_JOURNALS = ("-journal", "-wal")


class Overlay:
    """A bucket that is only read; new files go to another one. What is there already is never written again."""

    def __init__(self, below: Bucket, above: Bucket) -> None:
        self._below, self._above = below, above
        self.place = below.place

    def put(self, files: Mapping[str, bytes]) -> None:
        there = next((name for name in files if self._is_below(name)), None)
        if there is not None:
            raise Unwritable(f"{self.place}/{there} cannot be written; it is only looked at")
        self._above.put(files)

    def _is_below(self, name: str) -> bool:
        try:
            return self._below.get(name) is not None
        except Unreadable:
            return True

    def get(self, name: str) -> bytes | None:
        data = self._above.get(name)
        return self._below.get(name) if data is None else data

    def names(self, prefix: str) -> Iterator[tuple[str, float]]:
        yield from self._above.names(prefix)
        yield from self._below.names(prefix)

    def remove(self, name: str) -> None:
        self._above.remove(name)

    def adding(self) -> AbstractContextManager[None]:
        return self._above.adding()

    def tidying(self) -> AbstractContextManager[bool]:
        return contextlib.nullcontext(False)


class IndexCopy:
    """A copy of a store's SQLite index, and its files with those that only the copy has."""

    def __init__(self, root: Path, original: Contents, because: Unwritable) -> None:
        """Raises DataError: there is nothing to copy from, or nowhere to copy to."""
        assert original.database.path is not None
        self._root = root
        self._original = original.database.path
        folder, claim = _private_folder(because)
        self._removal = weakref.finalize(self, _remove, folder, os.getpid(), claim)
        with original.database.held_still():
            self._stamp = self._stamp_now()
            try:
                for path in self._parts():
                    with contextlib.suppress(FileNotFoundError):
                        shutil.copyfile(path, folder / path.name.replace(self._original.name, "maps.db", 1))
            except OSError as exc:  # cannot be read either, or there is no room for a copy
                raise Unwritable(f"{because} ({self._original} cannot be copied: {exc.strerror})") from exc
        database = Database("", folder, place=original.database.place)
        files = Overlay(original.bucket, FolderBucket(folder))
        self.contents = Contents(database, files, original.author, original.notify)
        told = why_unwritable(root)
        self.refusal = f"{cannot_write(root, told) if told else because}; until then its maps can be seen, not changed"

    @property
    def is_needed(self) -> bool:
        """The folder still takes no writes, and nobody else has written there."""
        return why_unwritable(self._root) is not None and self._stamp == self._stamp_now()

    def remove(self) -> None:
        self.contents.database.close()
        self._removal()

    def _parts(self) -> list[Path]:
        return [self._original, *(Path(f"{self._original}{ending}") for ending in _JOURNALS)]

    def _stamp_now(self) -> list[tuple[int, int, int] | None]:
        return [_stamp(path) for path in (*self._parts(), self._root / "records")]


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def _private_folder(because: Unwritable) -> tuple[Path, IO[bytes]]:
    """Where only this user looks, and the file that is locked meanwhile.

    In memory when the usual place is on the disk that takes no writes.
    """
    for parent in (None, "/dev/shm"):  # mkdtemp makes it private  # noqa: S108  # nosec B108
        with contextlib.suppress(OSError):
            folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
            claim = (folder / IN_USE).open("ab")
            with contextlib.suppress(OSError):  # files have no locks there: nobody removes it then
                lock(claim, timeout_s=0)
            _sweep(folder.parent)
            return folder, claim
    raise because


def _sweep(parent: Path) -> None:
    """Remove what a program that was killed could not."""
    for folder in parent.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if time.time() - folder.stat().st_mtime > FORGOTTEN_S and folder.stat().st_uid == os.getuid():
                with (folder / IN_USE).open("ab") as file:
                    if lock(file, timeout_s=0):
                        shutil.rmtree(folder, ignore_errors=True)


def _remove(folder: Path, owner: int, claim: IO[bytes]) -> None:
    claim.close()
    if os.getpid() == owner:  # a fork's end must not take it from who made it
        shutil.rmtree(folder, ignore_errors=True)
