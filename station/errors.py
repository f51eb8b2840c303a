"""Ordinary reasons why the station does not do what it was asked; each becomes a kind of problem document."""

from __future__ import annotations

from shared.errors import RobotSystemError


class Unknown(RobotSystemError):
    """There is no such thing (404)."""


class Conflict(RobotSystemError):
    """Not in the present state of things (409)."""


class NotDriver(Conflict):
    """Another one drives (409)."""


class NotCapable(Conflict):
    """This robot has no such part (409)."""


class NoRobot(RobotSystemError):
    """No robot is connected (503)."""


class OutOfRange(RobotSystemError):
    """A value is outside what is allowed (422)."""


class Busy(RobotSystemError):
    """As many use it already as are allowed (503)."""


class WrongToken(RobotSystemError):
    """Nobody knows who asks (401)."""


class NotAllowed(RobotSystemError):
    """Who asks is known, and may not (403)."""


class TooManyGuesses(RobotSystemError):
    """This address showed too many wrong tokens (429)."""

    def __init__(self, text: str, wait_s: float) -> None:
        super().__init__(text)
        self.wait_s = wait_s
