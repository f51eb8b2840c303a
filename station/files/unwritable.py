"""Why a place takes no writes, in a sentence with a remedy."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

from shared.disk import SCRATCH
from shared.errors import DataError

PROBE_BYTES = 64 * 1024  # an empty file can be made on many a full disk
_REMEDIES = {
    errno.EROFS: "make its disk writable again (one that fails is mounted read-only: check it)",
    errno.EIO: "check the disk",
    errno.ENOSPC: "free space",
    errno.EDQUOT: "free space",
    errno.EACCES: "run as the user that owns it",
    errno.EPERM: "run as the user that owns it",
}


class Unwritable(DataError):
    """A place takes no writes; what is there may well be read."""


def cannot_write(place: Path | str, exc: OSError) -> Unwritable:
    """The sentence for it."""
    remedy = _REMEDIES.get(exc.errno or 0, "check the folder")
    return Unwritable(f"{place} cannot be written ({exc.strerror or exc}); {remedy}, or choose another folder")


def why_unwritable(folder: Path) -> OSError | None:
    """What the system says to a small file in this folder, which is removed again; None: it takes writes.

    Of a folder that is not there: whether it could be made.
    """
    there = next((place for place in (folder, *folder.absolute().parents) if place.is_dir()), folder)
    try:
        with tempfile.TemporaryFile(prefix=SCRATCH, dir=there, buffering=0) as file:
            if file.write(bytes(PROBE_BYTES)) < PROBE_BYTES:
                return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as exc:
        return exc
    return None
