"""Telling a link that is too slow for driving from one that stood still for a moment."""

from __future__ import annotations

LATE_FOR_NS = 500_000_000


class LateCommands:
    """Notes which drive commands of one link come in time. Time is an argument.

    Commands that arrive older than they may hold move nothing. After a standstill they come in one burst and fresh
    ones follow; where they keep coming one by one, whoever holds the joystick must hear why nothing moves.
    """

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._last_ns = 0

    def note_fresh(self) -> None:
        """A command came in time."""
        self._since_ns = None

    def note_late(self, now_ns: int) -> bool:
        """A command came too late. True when they have done so, and nothing else, for LATE_FOR_NS, and again after."""
        if self._since_ns is None or now_ns - self._last_ns > LATE_FOR_NS:
            self._since_ns = now_ns
        self._last_ns = now_ns
        if now_ns - self._since_ns < LATE_FOR_NS:
            return False
        self._since_ns = None
        return True
