"""Whoever writes a recording holds its file; the kernel takes that back when the holder ends, however that was."""

from __future__ import annotations

import contextlib
import logging
from typing import BinaryIO

from shared.disk import lock, unlock

logger = logging.getLogger(__name__)


def hold(file: BinaryIO) -> bool:
    """Hold this file until it is closed. False: another program, or another part of this one, writes it."""
    return _could_lock(file, shared=False)


def is_being_written(file: BinaryIO) -> bool:
    """Whether somebody holds this file."""
    if not _could_lock(file, shared=True):
        return True
    with contextlib.suppress(OSError):
        unlock(file)
    return False


def _could_lock(file: BinaryIO, *, shared: bool) -> bool:
    """Where files cannot be locked (some network disks) each counts as free."""
    try:
        return lock(file, shared=shared, timeout_s=0)
    except OSError as exc:
        logger.warning("%s cannot be locked (%s)", file.name, exc.strerror)
        return True
