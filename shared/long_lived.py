"""Keeps Python's garbage collector from what a program loads once and needs to its end."""

from __future__ import annotations

import gc


def keep_for_good() -> None:
    """What exists now is never looked at again.

    A whole collection goes over each object there is, and nothing else happens meanwhile: commands, heartbeats and
    pictures of a station with its libraries waited 0.1 to 0.5 s, now and then. In a child process it would also write
    to, and so copy, pages that all children share.
    """
    gc.collect()
    gc.freeze()
