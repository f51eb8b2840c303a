"""What a link tells the log: a robot may say ever other things, thousands a second, and no log would hold them."""

from __future__ import annotations

import logging

from shared.repetition import Repetition

logger = logging.getLogger(__name__)

MAX_WARNINGS = 20  # different lines of one robot in a minute


class LinkLog:
    """Of one link. Each kind is bounded by itself: a robot that warns without end must not hide its end."""

    def __init__(self) -> None:
        self._notices = Repetition(MAX_WARNINGS)
        self._refusals = Repetition(MAX_WARNINGS)
        self._losses = Repetition(MAX_WARNINGS)
        self._refusal = ""  # the last one, while there was no connection since

    def notice(self, text: str) -> None:
        """What the robot says."""
        _warn(self._notices, f"robot: {text}")

    def lost(self, reason: str) -> None:
        """A connection is."""
        self._refusal = ""
        _warn(self._losses, f"robot lost: {reason}")

    def refused(self, reason: str) -> bool:
        """Somebody must do something before there is a connection; returns whether the reason is another one now."""
        if reason == self._refusal:
            return False
        self._refusal = reason
        _warn(self._refusals, f"no robot is connected: {reason}")
        return True


def _warn(said: Repetition, line: str) -> None:
    if (news := said.news(line)) is not None:
        logger.warning("%s", news)
