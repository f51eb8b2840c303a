"""Small disks that become full, or read-only as a failing one does: in the middle of whatever is being written."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol


class NoDisk(Exception):
    """A disk cannot be had here; why, in a sentence."""


class Disk(Protocol):
    """A file system of its own that can be made to refuse writing."""

    @property
    def home(self) -> Path:
        """Where to write."""
        ...

    def spoil(self) -> None:
        """From now on it refuses."""
        ...

    def keep_spoilt(self) -> None:
        """Call it often while it shall refuse: who writes also removes, and must not find room by that."""
        ...


class FullDisk:
    """A tmpfs, and a file that takes the rest of it."""

    def __init__(self, mounted: Path) -> None:
        self.home = mounted / "home"
        self._filler = mounted / "filler"

    def spoil(self) -> None:
        self.keep_spoilt()

    def keep_spoilt(self) -> None:
        with self._filler.open("ab", buffering=0) as file:
            for block in (1 << 20, 1 << 12):
                with contextlib.suppress(OSError):
                    while file.write(bytes(block)) == block:
                        pass

    def mend(self) -> None:
        self._filler.unlink()


class FailingDisk:
    """An ext4 in a file: told of an error, its kernel lets nobody write any more, not even into files that are open."""

    def __init__(self, mounted: Path) -> None:
        self.home = mounted / "home"
        self._mounted = mounted

    def settle(self) -> None:
        """What is there reaches the disk: what is copied there only for the test need not survive its end."""
        _run("sync", "--file-system", str(self._mounted))

    def spoil(self) -> None:
        device = next(line.split()[0] for line in mounts() if line.split()[1] == str(self._mounted))
        try:
            Path("/sys/fs/ext4", Path(device).name, "trigger_fs_error").write_text("crash test")
        except OSError as exc:  # a container, most likely
            raise NoDisk(f"the kernel lets nobody fail a disk here ({exc.strerror})") from exc

    def keep_spoilt(self) -> None:
        """It stays so until it is mounted again."""


@contextlib.contextmanager
def full_disk(size: str = "96m") -> Iterator[FullDisk]:
    """Raises NoDisk where none can be mounted."""
    with _folder() as folder, _mounted(["-t", "tmpfs", "-o", f"size={size}", "none"], folder):
        yield FullDisk(folder)


@contextlib.contextmanager
def disk_image(size: str = "96m") -> Iterator[Path]:
    """A file with an ext4 in it, kept in memory."""
    with _folder() as folder, _mounted(["-t", "tmpfs", "-o", f"size={size}", "none"], folder):
        image = folder / "image"
        with image.open("wb") as file:
            free = os.statvfs(folder)
            file.truncate(free.f_bavail * free.f_frsize - (1 << 20))
        _run("mkfs.ext4", "-q", "-F", "-m", "0", "-O", "^resize_inode", str(image))
        yield image


@contextlib.contextmanager
def failing_disk(image: Path) -> Iterator[FailingDisk]:
    """The image, mounted. Again after it failed: it is sound again, with what had reached it."""
    with _folder() as folder, _mounted(["-o", "loop,errors=remount-ro", str(image)], folder):
        yield FailingDisk(folder)


@contextlib.contextmanager
def _mounted(what: list[str], folder: Path) -> Iterator[None]:
    if os.getuid() != 0:
        raise NoDisk("only root may mount a small disk")
    _run("mount", *what, str(folder))
    try:
        yield
    finally:
        _run("umount", str(folder))


@contextlib.contextmanager
def _folder() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="disk-")).resolve()
    try:
        yield folder
    finally:
        folder.rmdir()  # never anything that is still mounted


def mounts() -> list[str]:
    return Path("/proc/mounts").read_text().splitlines()


def _run(*command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError as exc:
        raise NoDisk(f"{command[0]} is not installed here") from exc
    if done.returncode != 0:
        raise NoDisk(f"{' '.join(command)}: {done.stderr.strip()}")
