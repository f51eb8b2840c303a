"""Files and folders that are there whole or not at all and survive a power cut; locks that end with their holder."""

from __future__ import annotations

import contextlib
import fcntl
import glob
import math
import os
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, BinaryIO

SCRATCH = ".part-"  # what a killed writer leaves behind begins with this
_OUR_SCRATCH = re.compile(re.escape(SCRATCH) + "[0-9a-f]{16}")
_NEW, _BEFORE = ".new-", "before"
_NAMELESS = "old"  # what programs until 27 November 2026 called what is now `before/NAME`
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
PRIVATE = 0o600  # the mode of a file that only its owner may read
_LOOK_AGAIN_S = 0.05
_ON_DISK = Path("/var/tmp")  # /tmp may be memory itself  # noqa: S108  # nosec B108


def flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Make a folder and the parents it lacks; their names survive a power cut."""
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        flush(folder.parent)


def spill_folder() -> Path:
    """Where files without names go that take what memory should not hold: on a disk, as far as one can be written."""
    is_on_disk = "TMPDIR" not in os.environ and os.access(_ON_DISK, os.W_OK)
    return _ON_DISK if is_on_disk else Path(tempfile.gettempdir())


@contextlib.contextmanager
def replacing(path: Path, *, scratch: Path | None = None, mode: int = 0o666) -> Iterator[BinaryIO]:
    """A file to write, which takes the place of `path` when the block ends and then survives a power cut.

    Where the block raises, or the program is killed, what was at `path` stays.

    Args:
        scratch: where it is written until then, in the same folder; only for a `path` with one writer at a time, whose
            next write removes what a killed one left. Otherwise a new name each time: several may write at once.
        mode: its permissions, before the umask.
    """
    with _taking_name(path, scratch, mode) as file:
        yield file
    flush(path.parent)


@contextlib.contextmanager
def _taking_name(path: Path, scratch: Path | None, mode: int) -> Iterator[BinaryIO]:
    """As `replacing`, but a power cut may still bring the old file back."""
    if scratch is None:
        scratch, descriptor = _new_scratch(path, mode)
    else:
        scratch.unlink(missing_ok=True)
        descriptor = os.open(scratch, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            os.fsync(descriptor)
            scratch.replace(path)  # while it is locked
    except BaseException:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise


def _new_scratch(path: Path, mode: int) -> tuple[Path, int]:
    """A new file beside `path`, and its descriptor; locked until that is closed, so that `remove_scratch` leaves it."""
    while True:
        scratch = path.with_name(f"{SCRATCH}{secrets.token_hex(8)}")
        descriptor = os.open(scratch, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        _lock_where_possible(descriptor)
        if scratch.exists():
            return scratch, descriptor
        os.close(descriptor)  # it was removed before it was locked


def remove_scratch(root: Path) -> None:
    """Remove the files that killed writers left in a folder and below it, at a program's start.

    What is being written stays, and what cannot be removed.
    """
    for folder, _, names in os.walk(root):
        for name in names:
            if _OUR_SCRATCH.fullmatch(name):
                with contextlib.suppress(OSError):
                    _remove_unless_locked(Path(folder, name))


def _remove_unless_locked(scratch: Path) -> None:
    descriptor = os.open(scratch, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        scratch.unlink()
    finally:
        os.close(descriptor)


def replace_file(path: Path, content: bytes, *, scratch: Path | None = None, mode: int = 0o666) -> None:
    """Write a whole file, as `replacing` does."""
    with replacing(path, scratch=scratch, mode=mode) as file:
        file.write(content)


def replace_files(contents: Mapping[Path, bytes], *, mode: int = 0o666) -> None:
    """Write several whole files. Their names are flushed at the end, a folder at a time: sooner than one by one."""
    for path, content in contents.items():
        with _taking_name(path, None, mode) as file:
            file.write(content)
    for folder in {path.parent for path in contents}:
        flush(folder)


@contextlib.contextmanager
def replacing_folder(folder: Path) -> Iterator[Path]:
    """A new folder to fill, which takes the place of `folder` when the block ends and then survives a power cut.

    Where the block raises, or the new one cannot take the name, the old one stays. Where the program is killed while
    the two exchange their name, it is given back to the old one if folders can be locked there: by `settle_folders`,
    by `settle_folder`, which readers call, or when this is called again.
    """
    settle_folder(folder)
    scratch, descriptor = _new_scratch_folder(folder.parent)
    fresh, old = scratch / "fresh", scratch / _BEFORE / folder.name
    try:
        fresh.mkdir()
        yield fresh
        for path in (fresh, *fresh.rglob("*")):
            flush(path)
        if folder.exists():
            old.parent.mkdir()
            folder.rename(old)
        fresh.rename(folder)
        flush(folder.parent)
    finally:
        with contextlib.suppress(OSError):
            _settle(scratch)
        os.close(descriptor)


def _new_scratch_folder(parent: Path) -> tuple[Path, int]:
    """A new folder and its descriptor; locked until that is closed, so that `settle_folders` leaves it."""
    while True:
        scratch = Path(tempfile.mkdtemp(prefix=_NEW, dir=parent))
        with contextlib.suppress(FileNotFoundError):  # it was removed before it was locked
            descriptor = os.open(scratch, _FOLDER)
            _lock_where_possible(descriptor)
            if scratch.exists():
                return scratch, descriptor
            os.close(descriptor)


def settle_folders(parent: Path, name: str) -> None:
    """Put right what killed programs left of `replacing_folder` in a folder of ours. What is being written stays.

    `name`: what is replaced there; older programs did not write it down.
    """
    for scratch in parent.glob(f"{_NEW}*"):
        _settle_unless_locked(scratch, name)


def settle_folder(folder: Path) -> None:
    """Give a folder its name back that a killed program took from it. Others beside it may be anybody's and stay."""
    if folder.exists():
        return
    for old in folder.parent.glob(f"{_NEW}*/{_BEFORE}/{glob.escape(folder.name)}"):
        _settle_unless_locked(old.parent.parent)


def _settle_unless_locked(scratch: Path, name: str = "") -> None:
    with contextlib.suppress(OSError):
        descriptor = os.open(scratch, _FOLDER)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if name and (scratch / _NAMELESS).is_dir():
                (scratch / _BEFORE).mkdir(exist_ok=True)
                (scratch / _NAMELESS).rename(scratch / _BEFORE / name)
            _settle(scratch)
        finally:
            os.close(descriptor)


def _settle(scratch: Path) -> None:
    """Give an old folder its name back where no new one has taken it, and remove the rest.

    Raises OSError, and removes nothing, where it cannot be given back.
    """
    for old in (scratch / _BEFORE).glob("*"):
        if not (scratch.parent / old.name).exists():
            old.rename(scratch.parent / old.name)
            flush(scratch.parent)
    shutil.rmtree(scratch, ignore_errors=True)


def _lock_where_possible(descriptor: int) -> None:
    """So that a program which starts leaves it. Some network disks lock nothing; there nothing is removed either."""
    with contextlib.suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_EX)


def lock(file: IO[bytes], *, shared: bool = False, timeout_s: float = math.inf) -> bool:
    """Lock an open file until it is closed, alone or with others who share it. False: somebody else holds it.

    The kernel ends the lock with its holder, however that ends. `timeout_s`: how long to wait; 0 asks once.

    Raises:
        OSError: files cannot be locked here (some network disks).
    """
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    if timeout_s == math.inf:
        fcntl.flock(file, kind)
        return True
    deadline_s = time.monotonic() + timeout_s
    while True:
        try:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if time.monotonic() >= deadline_s:
                return False
            time.sleep(_LOOK_AGAIN_S)


def unlock(file: IO[bytes]) -> None:
    """Give a lock back before the file is closed."""
    fcntl.flock(file, fcntl.LOCK_UN)
