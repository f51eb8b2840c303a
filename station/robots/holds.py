"""For which robot each driver began to drive: a joystick that is held on moves no other one. Time is an argument."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

from shared.lease import LET_GO_NS, LISTENING_NS

MAX_HOLDS = 64  # drivers at a time; who has been silent is forgotten anyway


@dataclass(slots=True)
class _Hold:
    robot: Hashable | None  # None: it began before any robot was known
    ends_ns: int  # silent until then, and it was let go


class Holds:
    """Commands of one driver that follow each other without a pause are one hold, and mean the robot of its beginning.

    A robot may be another one by the next command: at an address of before, or found in place of one that was
    forgotten. Whoever holds on, be it through minutes without any robot, has to let go before driving that one.
    """

    def __init__(self) -> None:
        self._holds: dict[str, _Hold] = {}
        self._listened_ns: int | None = None  # when `listen` was called last

    def listen(self, now_ns: int) -> None:
        """To be called often by whoever hears drivers: while that stands still there is no silence, but deafness."""
        if self._listened_ns is not None:
            deaf_ns = max(0, now_ns - self._listened_ns - LISTENING_NS)
            for hold in self._holds.values():
                hold.ends_ns += deaf_ns
        self._listened_ns = now_ns

    def hear(self, driver: str, robot: Hashable | None, now_ns: int, hold_ns: int = 0) -> bool:
        """A command of this driver that holds for `hold_ns`. False: the hold began with another robot.

        Args:
            robot: the one that is connected, else the one that was last; None: none ever was.
        """
        if self._listened_ns is not None:
            self.listen(now_ns)
        hold = self._holds.pop(driver, None)
        if hold is None or now_ns >= hold.ends_ns:
            hold = _Hold(robot, 0)
        if hold.robot is None:
            hold.robot = robot
        hold.ends_ns = max(hold.ends_ns, now_ns + hold_ns + LET_GO_NS)
        self._holds[driver] = hold  # behind all others
        if len(self._holds) > MAX_HOLDS:
            del self._holds[next(iter(self._holds))]
        return hold.robot == robot

    def let_go(self, driver: str | None) -> None:
        """The next command of this driver begins anew."""
        self._holds.pop(driver or "", None)
