"""Where the robot may be when nobody gave its address: all that make themselves known, one after another."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from shared.errors import ConfigError
from station.access.paired_robots import PairedRobot, PairedRobots
from station.robots.link_state import RobotIdentity

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

    The first robot that took the station in is the one that is meant from then on, as long as the station runs, also
    when it is forgotten: another one is not taken in its place unless it is paired after that.
    """

    def __init__(self, robots: PairedRobots | None, find: Find, now_s: Callable[[], float] = time.monotonic) -> None:
        self._robots = robots
        self._find = find
        self._now_s = now_s
        self._waiting: list[FoundRobot] = []
        self._refused_s: dict[tuple[str, int], float] = {}
        self._reasons: list[str] = []  # of this round
        self._met: RobotIdentity | None = None  # the robot that is meant
        self._met_name = ""
        self._paired: tuple[PairedRobot, ...] = ()  # when it could be looked up last
        # All by certificate and token, which each pairing makes anew, when the one that is meant was among them last.
        self._paired_then: set[tuple[str, str]] = set()

    @property
    def has_more(self) -> bool:
        """Whether somebody is left to be tried without looking anew."""
        return bool(self._waiting)

    async def next(self) -> FoundRobot | None:
        """Whom to try now; None: nobody makes itself known."""
        if not self._waiting:
            self._look_who_is_paired()
            found = await asyncio.to_thread(self._find, FIND_WITHIN_S, [robot.robot_id for robot in self._paired])
            self._waiting = self._ordered(found)
            self._reasons.clear()
        return self._waiting.pop(0) if self._waiting else None

    def refusal(self, robot: RobotIdentity) -> str:
        """Why a robot that answers is not the one that is meant; empty: it is, or may become it."""
        if self._met is None or _is_same(self._met, robot):
            return ""
        met, certificate = self._met.fingerprint.hex(), robot.fingerprint.hex()
        names = {paired.fingerprint: paired.name for paired in self._paired}
        who = f"{names.get(certificate, 'another robot')} answers, and {self._met_name} was found before"
        if not met or met in names:
            return f"{who}; start the station again to look for any robot, or give each its NAME=HOST:PORT"
        if any(one not in self._paired_then for one in self._pairings() if one[0] == certificate):
            return ""
        return f"{who}, which is not paired any more; start the station again to look for any robot, or pair anew"

    def accept(self, robot: RobotIdentity) -> None:
        """It took the station in."""
        names = {paired.fingerprint: paired.name for paired in self._paired}
        self._met, self._met_name = robot, names.get(robot.fingerprint.hex(), robot.robot_id)
        self._paired_then = self._pairings()
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

    def _ordered(self, found: Collection[FoundRobot]) -> list[FoundRobot]:
        ids, hosts = {robot.robot_id for robot in self._paired}, {robot.host for robot in self._paired}
        now_s = self._now_s()

        def worth(robot: FoundRobot) -> tuple[bool, int, float]:
            refused_s = self._refused_s.get((robot.host, robot.port), -REFUSED_FOR_S + now_s)
            is_refused = now_s - refused_s < REFUSED_FOR_S
            unlike = (robot.robot_id not in ids) + (robot.host not in hosts)  # anybody can tell one's id
            return is_refused, unlike, refused_s

        return sorted(dict.fromkeys(found), key=worth)[:MAX_TRIED]

    def _look_who_is_paired(self) -> None:
        if self._robots is None:
            return
        try:
            self._paired = self._robots.all()
        except ConfigError:  # says nothing of who is paired; the attempt to connect says what is wrong with the file
            return
        if self._met is not None and self._met.fingerprint.hex() in {robot.fingerprint for robot in self._paired}:
            self._paired_then = self._pairings()

    def _pairings(self) -> set[tuple[str, str]]:
        return {(robot.fingerprint, robot.token) for robot in self._paired}


def _is_same(met: RobotIdentity, robot: RobotIdentity) -> bool:
    """By the certificate. One that showed none has only its id, and may have been given a certificate since."""
    return robot.fingerprint == met.fingerprint if met.fingerprint else robot.robot_id == met.robot_id


def find_in_network(seconds: float, paired: Collection[str]) -> Collection[FoundRobot]:
    # Imported only here: zeroconf opens sockets of its own, and who gives an address does not need it.
    from station.robots.discovery import find_robots

    return find_robots(seconds, paired)
