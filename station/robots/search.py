"""Where the robot may be when nobody gave its address: all that make themselves known, one after another."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from shared.errors import ConfigError
from station.access.paired_robots import PairedRobot, PairedRobots

FIND_WITHIN_S = 2.0
REFUSED_FOR_S = 60.0
MAX_REFUSALS = 256
MAX_TRIED = 16  # in one round; who was not tried lately comes before who was


@dataclass(frozen=True, slots=True)
class FoundRobot:
    """What makes itself known as a robot. Anybody may."""

    robot_id: str
    host: str
    port: int


NO_ROBOT_FOUND = (
    "no robot makes itself known in this network; start robot-server with --host 0.0.0.0 there, or give its HOST:PORT"
)
Find = Callable[[float, Collection[str]], Collection[FoundRobot]]  # seconds, ids of paired robots


class RobotSearch:
    """Hands out addresses to try: those that look like paired robots first, those that refused lately last.

    The first robot that took the station in is the one that is meant from then on, as long as the station runs:
    another one in its place would be driven by who drove the first.
    """

    def __init__(self, robots: PairedRobots | None, find: Find, now_s: Callable[[], float] = time.monotonic) -> None:
        self._robots = robots
        self._find = find
        self._now_s = now_s
        self._waiting: list[FoundRobot] = []
        self._refused_s: dict[tuple[str, int], float] = {}
        self._reasons: list[str] = []  # of this round
        self._met = b""  # the fingerprint of the robot that is meant

    @property
    def has_more(self) -> bool:
        """Whether somebody is left to be tried without looking anew."""
        return bool(self._waiting)

    async def next(self) -> FoundRobot | None:
        """Whom to try now; None: nobody makes itself known."""
        if not self._waiting:
            paired = self._paired()
            found = await asyncio.to_thread(self._find, FIND_WITHIN_S, [robot.robot_id for robot in paired])
            self._waiting = self._ordered(found, paired)
            self._reasons.clear()
        return self._waiting.pop(0) if self._waiting else None

    def refusal(self, fingerprint: bytes) -> str:
        """Why a paired robot (empty: one without TLS) is not the one that is meant; empty: it is, or may become it."""
        if fingerprint == self._met or not self._met:
            return ""
        names = {robot.fingerprint: robot.name for robot in self._paired()}
        if self._met.hex() not in names:  # it was forgotten
            self._met = b""
            return ""
        who = names.get(fingerprint.hex(), "another robot")
        return (
            f"{who} answers, and {names[self._met.hex()]} was found before; start the station again"
            " to look for any robot, or give each its NAME=HOST:PORT"
        )

    def accept(self, fingerprint: bytes) -> None:
        """It took the station in."""
        self._met = self._met or fingerprint
        self._waiting.clear()

    def refuse(self, found: FoundRobot, reason: str) -> str:
        """It did not; the sentence for this round of trying."""
        self._refused_s.pop((found.host, found.port), None)
        self._refused_s[found.host, found.port] = self._now_s()
        while len(self._refused_s) > MAX_REFUSALS:
            del self._refused_s[next(iter(self._refused_s))]
        self._reasons.append(reason)
        others = len(self._reasons) - 1
        more = f"; {others} more made themselves known, and none took this station in" if others else ""
        return self._reasons[0] + more

    def _ordered(self, found: Collection[FoundRobot], paired: tuple[PairedRobot, ...]) -> list[FoundRobot]:
        ids, hosts = {robot.robot_id for robot in paired}, {robot.host for robot in paired}
        now_s = self._now_s()

        def worth(robot: FoundRobot) -> tuple[bool, int, float]:
            refused_s = self._refused_s.get((robot.host, robot.port), -REFUSED_FOR_S + now_s)
            is_refused = now_s - refused_s < REFUSED_FOR_S
            unlike = (robot.robot_id not in ids) + (robot.host not in hosts)  # anybody can tell one's id
            return is_refused, unlike, refused_s

        return sorted(dict.fromkeys(found), key=worth)[:MAX_TRIED]

    def _paired(self) -> tuple[PairedRobot, ...]:
        try:
            return () if self._robots is None else self._robots.all()
        except ConfigError:
            return ()  # the attempt to connect says what is wrong with the file


def find_in_network(seconds: float, paired: Collection[str]) -> Collection[FoundRobot]:
    # Imported only here: zeroconf opens sockets of its own, and who gives an address does not need it.
    from station.robots.discovery import find_robots

    return find_robots(seconds, paired)
