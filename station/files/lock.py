"""Whoever writes a recording holds its file; the kernel takes that back when the holder ends, however that was."""

from __future__ import annotations

import contextlib
import fcntl
import logging
from typing import BinaryIO

logger = logging.getLogger(__name__)


def hold(file: BinaryIO) -> bool:
    """Hold this file until it is closed. False: another program, or another part of this one, writes it."""
    return _is_free(file, fcntl.LOCK_EX)


def is_being_written(file: BinaryIO) -> bool:
    """Whether somebody holds this file."""
    if not _is_free(file, fcntl.LOCK_SH):
        return True
    with contextlib.suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_UN)
    return False


def _is_free(file: BinaryIO, kind: int) -> bool:
    """Where files cannot be locked (some network disks) each counts as free."""
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as exc:
        logger.warning("%s cannot be locked (%s)", file.name, exc.strerror)
    return True
