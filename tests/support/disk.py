"""Folders that take no writes, and disks that are full."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
from collections.abc import Iterator
from io import BufferedReader, FileIO
from pathlib import Path

import pytest

from shared import bounded


@contextlib.contextmanager
def unwritable(folder: Path) -> Iterator[None]:
    """Root may write whatever the permissions say, so for it the folder becomes a read-only mount of itself."""
    if os.getuid() != 0:
        modes = {path: path.stat().st_mode for path in (folder, *folder.rglob("*"))}
        for path, mode in modes.items():
            path.chmod(mode & ~0o222)
        try:
            yield
        finally:
            for path, mode in modes.items():
                path.chmod(mode)
        return
    _mount("--bind", folder, folder)
    try:
        _mount("-o", "remount,bind,ro", folder)
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A file system of its own; skips where it cannot be mounted."""
    if os.getuid() != 0:
        pytest.skip("only root may mount a small disk")
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", folder], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"no tmpfs can be mounted here: {mounted.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


class BadSectors:
    """Files of which a read ends with EIO, as on a disk that has them: every other call goes well."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.paths: set[Path] = set()
        self._open = bounded.open_file
        monkeypatch.setattr(bounded, "open_file", self._opened)

    def _opened(self, path: Path, **options: bool) -> BufferedReader:
        file = self._open(path, **options)
        if path not in self.paths:
            return file
        file.close()
        return BufferedReader(_BadFile(str(path)))


class _BadFile(FileIO):
    def readinto(self, buffer: object, /) -> int:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    def readall(self) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))


def fill(disk: Path) -> None:
    """Leave not one block free."""
    with (disk / "fill").open("ab", buffering=0) as file, contextlib.suppress(OSError):
        while file.write(bytes(4096)):
            pass


def _mount(*options: str | Path) -> None:
    done = subprocess.run(["mount", *options], capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"nothing can be mounted here: {done.stderr.strip()}")
