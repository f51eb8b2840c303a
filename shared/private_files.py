"""Files that only their owner may read, replaced whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from shared.bounded import MAX_JSON_BYTES, Refused, open_file
from shared.disk import PRIVATE, lock, replacing
from shared.errors import ConfigError

_OTHERS = 0o077
_SPARE_BYTES = 64 * 1024  # a book of tokens has some 300 bytes for each


def make_private_folder(folder: Path) -> None:
    """A folder that only its owner may enter. Raises ConfigError."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        folder.chmod(0o700)
    except OSError as exc:
        raise ConfigError(f"{folder} cannot be made ({exc.strerror}); give a folder that you may write to") from exc


def write_private(path: Path, content: bytes) -> None:
    """Replace a file in one step, mode 0600: no power cut brings back who was revoked.

    On a full disk it takes the space that `keep_spare` kept. Raises ConfigError; the old one stays then.
    """
    try:
        try:
            _replace(path, content)
        except OSError as exc:
            if exc.errno not in (errno.ENOSPC, errno.EDQUOT) or not _spare_of(path).exists():
                raise
            _spare_of(path).unlink()
            _replace(path, content)
    except OSError as exc:
        raise ConfigError(f"{path} cannot be written ({exc.strerror}); free space or correct its owner") from exc


def keep_spare(path: Path) -> None:
    """Keep space beside a file for the time when the disk is full; nothing where there is none to keep."""
    spare = _spare_of(path)
    with contextlib.suppress(OSError):
        if not spare.exists():
            _replace(spare, os.urandom(_SPARE_BYTES))  # zeros would take no space on some disks


def _spare_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.spare")


def _replace(path: Path, content: bytes) -> None:
    with replacing(path, mode=PRIVATE) as file:
        _give_to_owner_of_folder(file.fileno(), path)
        file.write(content)


def read_private(path: Path) -> bytes | None:
    """The content; None: there is no such file. Raises ConfigError when others may read it too, or it is no file."""
    try:
        with open_file(path) as file:
            status = os.fstat(file.fileno())
            if status.st_mode & _OTHERS:
                raise ConfigError(f"{path} holds secrets and others may read it; run: chmod 600 {path}")
            if status.st_size > MAX_JSON_BYTES:
                raise ConfigError(f"{path} has {status.st_size} bytes, more than such a file ever has; move it away")
            return file.read(status.st_size)
    except Refused as exc:
        raise ConfigError(f"{path} cannot be read: {exc}; put a regular file in its place, or move it away") from exc
    except FileNotFoundError:
        return None
    except OSError as exc:
        raise ConfigError(f"{path} cannot be read ({exc.strerror}); run as the user that owns it") from exc


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep other programs from changing a file meanwhile; a file beside it, `.lock`, is what is locked."""
    try:
        # root must not follow a link that the folder's owner may have put there
        name = path.with_name(f"{path.name}.lock")
        try:
            descriptor = os.open(name, os.O_RDWR | os.O_NOFOLLOW)
        except FileNotFoundError:
            descriptor = os.open(name, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, PRIVATE)
            _give_to_owner_of_folder(descriptor, name)
    except OSError as exc:
        raise ConfigError(f"{path.parent} cannot be written ({exc.strerror}); run as the user that owns it") from exc
    with os.fdopen(descriptor, "rb") as file:
        lock(file)
        yield


def _give_to_owner_of_folder(descriptor: int, path: Path) -> None:
    """What root writes for a service (`sudo robot-server access revoke NAME`) must stay readable to it."""
    if os.geteuid() == 0:
        owner = path.parent.stat()
        os.fchown(descriptor, owner.st_uid, owner.st_gid)
