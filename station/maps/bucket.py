"""Where a store's files lie: a folder, or anything fsspec reaches by URL. A file is there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

from shared.bounded import MAX_FILE_BYTES, MB, read_file
from shared.disk import PRIVATE, lock, make_folder, replace_files
from shared.errors import ConfigError, DataError
from station.files.unwritable import cannot_write

ADDING = ".adding"  # locked by everybody who writes files that no record names yet
# What says that a file is not what was written: a bad sector, a broken file system, too many bytes, no file at all.
# Others are of who looks, or of the moment: without permission or descriptors every file were damaged.
_OF_THE_FILE = frozenset(
    (errno.EIO, errno.EBADMSG, errno.EUCLEAN, errno.ENODATA, errno.EFBIG, errno.EISDIR, errno.ENXIO, errno.ELOOP)
)
_PASSWORD = re.compile(r"(://[^/@]*?:)[^/@]*@")  # in a URL


class Unreadable(DataError):
    """One file cannot be read; others can, as far as that tells."""


class Bucket(Protocol):
    """Named files, `part/of/the/path`. All methods raise DataError when the place cannot be used."""

    @property
    def place(self) -> str:
        """What messages call it."""
        ...

    def put(self, files: Mapping[str, bytes]) -> None:
        """Write them; when this returns they survive a power cut."""
        ...

    def get(self, name: str) -> bytes | None:
        """A file's bytes; None when it is not there. Raises Unreadable."""
        ...

    def names(self, prefix: str) -> Iterator[tuple[str, float]]:
        """The files whose name begins with `prefix/`, with their age in seconds."""
        ...

    def remove(self, name: str) -> None:
        """Forget a file, if it is there."""
        ...

    def adding(self) -> AbstractContextManager[None]:
        """While files are written that no record names yet, so that nobody tidies them away."""
        ...

    def tidying(self) -> AbstractContextManager[bool]:
        """Alone: False where somebody is adding, as far as locks tell. Where there are none files' ages must do."""
        ...


class FolderBucket:
    """A folder: written beside, flushed, renamed."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self.place = str(root)

    def put(self, files: Mapping[str, bytes]) -> None:
        for name, data in files.items():
            if len(data) > MAX_FILE_BYTES:  # `get` would refuse it
                sizes = f"{len(data) // MB} MB, more than the {MAX_FILE_BYTES // MB} MB that are read"
                raise DataError(f"{self._root / name} is not written: it has {sizes}; make a map of shorter drives")
        try:
            contents = {self._root / name: data for name, data in files.items()}
            for folder in {path.parent for path in contents}:
                make_folder(folder)
            replace_files(contents, mode=PRIVATE)
        except OSError as exc:
            raise cannot_write(self._root, exc) from exc

    def get(self, name: str) -> bytes | None:
        try:
            return read_file(self._root / name, MAX_FILE_BYTES)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as exc:
            kind = Unreadable if exc.errno in _OF_THE_FILE else DataError
            raise kind(f"{self._root / name} cannot be read ({exc.strerror}); check the disk") from exc

    def names(self, prefix: str) -> Iterator[tuple[str, float]]:
        now = time.time()
        for folder, _, files in os.walk(self._root / prefix):
            for file in sorted(files):
                path = Path(folder, file)
                with contextlib.suppress(FileNotFoundError):  # taken away meanwhile
                    yield path.relative_to(self._root).as_posix(), now - path.stat().st_mtime

    def remove(self, name: str) -> None:
        try:
            (self._root / name).unlink(missing_ok=True)
        except OSError as exc:
            raise cannot_write(self._root, exc) from exc

    @contextlib.contextmanager
    def adding(self) -> Iterator[None]:
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(OSError):  # `put` says it better where the folder takes no writes
                make_folder(self._root)
                lock(stack.enter_context((self._root / ADDING).open("ab")), shared=True)
            yield

    @contextlib.contextmanager
    def tidying(self) -> Iterator[bool]:
        with contextlib.ExitStack() as stack:
            is_alone = True
            with contextlib.suppress(OSError):
                make_folder(self._root)
                is_alone = lock(stack.enter_context((self._root / ADDING).open("ab")), timeout_s=0)
            yield is_alone


class UrlBucket:
    """An object store, by fsspec. An object there appears whole when its upload ends."""

    def __init__(self, url: str) -> None:
        import fsspec  # loaded only where a URL is given

        self.place = _PASSWORD.sub(r"\1***@", url)
        try:
            self._files, self._root = fsspec.core.url_to_fs(url)
        except (ImportError, ValueError, OSError) as exc:
            raise ConfigError(
                f"store.blobs = {self.place!r} cannot be used ({exc}); give a URL that fsspec knows"
            ) from exc

    def put(self, files: Mapping[str, bytes]) -> None:
        try:
            for folder in {self._path(name).rpartition("/")[0] for name in files}:
                self._files.makedirs(folder, exist_ok=True)
            for name, data in files.items():
                self._files.pipe_file(self._path(name), data)
        except OSError as exc:
            raise self._unusable(exc) from exc

    def get(self, name: str) -> bytes | None:
        try:
            data: bytes = self._files.cat_file(self._path(name))
        except FileNotFoundError:
            return None
        except OSError as exc:
            raise self._unusable(exc) from exc
        return data

    def names(self, prefix: str) -> Iterator[tuple[str, float]]:
        now = time.time()
        try:
            found: dict[str, dict[str, Any]] = self._files.find(self._path(prefix), detail=True)
        except FileNotFoundError:
            return
        except OSError as exc:
            raise self._unusable(exc) from exc
        for path, detail in sorted(found.items()):
            yield path[len(self._root) :].lstrip("/"), now - _changed_s(detail, now)

    def remove(self, name: str) -> None:
        try:
            with contextlib.suppress(FileNotFoundError):
                self._files.rm_file(self._path(name))
        except OSError as exc:
            raise self._unusable(exc) from exc

    def adding(self) -> AbstractContextManager[None]:
        return contextlib.nullcontext()

    def tidying(self) -> AbstractContextManager[bool]:
        return contextlib.nullcontext(True)

    def _path(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}"

    def _unusable(self, exc: OSError) -> DataError:
        return DataError(f"{self.place} cannot be used ({exc}); check the address and the connection")


def open_bucket(place: str, root: Path) -> Bucket:
    """The bucket at a URL; without one the folder `root`."""
    if not place:
        return FolderBucket(root)
    if "://" not in place or place.startswith("file://"):
        return FolderBucket(Path(place.removeprefix("file://")))
    return UrlBucket(place)


def _changed_s(detail: dict[str, Any], now: float) -> float:
    """When an object was written; now where its file system does not say, so that it is never taken for old."""
    for key in ("LastModified", "mtime", "created", "last_modified"):
        value = detail.get(key)
        if value is not None:
            return float(value.timestamp()) if hasattr(value, "timestamp") else float(value)
    return now
