"""Who drives, and the station's own timer that stops the robot when the driver goes silent."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from shared.lease import DriverLease
from shared.messages import MAX_DRIVE_TTL_MS, Capabilities
from station.config import DriveConfig
from station.errors import Conflict, NoRobot, NotCapable, NotDriver, OutOfRange
from station.robots.holds import Holds
from station.robots.link_state import RobotIdentity

MAX_TTL_MS = 1000  # how long one POST may hold; the joystick's commands hold 250 ms at most (station/api/robot.py)
MAX_DRIVER_NAME = 64
TAKE_OVER_S = 5.0  # until the first command: time to reach for the joystick, or to type the next line
TURN_NS = 1_000_000_000  # servos need half a second from one end to the other; the picture is a little late
AHEAD = (0.0, 0.0)  # pan, tilt: as the calibration has the camera
LATE_FOR_NS = 500_000_000  # a link late for that long is too slow, and not at a standstill for a moment


class CameraHead:
    """The last command to a pan-tilt head. Time is an argument."""

    def __init__(self) -> None:
        self._pan_tilt = AHEAD
        self._rests_ns = 0  # when it looks there

    @property
    def is_centred(self) -> bool:
        """Whether the head was told to look straight ahead."""
        return self._pan_tilt == AHEAD

    def looks_ahead(self, now_ns: int) -> bool:
        """Whether it has also had the time to get there: only then is the camera where the calibration says."""
        return self.is_centred and now_ns >= self._rests_ns

    def turn(self, pan: float, tilt: float, now_ns: int) -> None:
        """The head was told to look there (rad)."""
        if (pan, tilt) != self._pan_tilt:
            self._pan_tilt, self._rests_ns = (pan, tilt), now_ns + TURN_NS


class DriveLink(Protocol):
    """What driving needs of the link to the robot."""

    def drive(self, linear: float, angular: float, ttl_ms: int, most_ms: int = MAX_DRIVE_TTL_MS) -> bool: ...

    def stop(self, *, until_confirmed: bool = False) -> bool: ...

    def point(self, pan: float, tilt: float) -> bool: ...


@dataclass(frozen=True, slots=True)
class _Command:
    linear: float
    angular: float
    until_ns: int
    robot: RobotIdentity | None  # no other one


class Driving:
    """Checks commands, keeps the lease, repeats a long command to the robot and stops it when its time is over.

    A command goes to the robot for which its driver began to drive, and to no other: whoever holds on while another one
    takes its place must let go first.
    """

    def __init__(
        self,
        link: DriveLink,
        config: DriveConfig,
        capabilities: Callable[[], Capabilities | None],
        robot: Callable[[], RobotIdentity | None],
        on_driver: Callable[[str | None], None],
        on_silence: Callable[[str], None],
        now_ns: Callable[[], int] = time.monotonic_ns,
        on_command: Callable[[str, float, float, int], None] = lambda *_: None,
        must_stand: Callable[[], str] = lambda: "",
        other_station: Callable[[], str | None] = lambda: None,
        why_alone: Callable[[], str] = lambda: "",
    ) -> None:
        """`capabilities` are those of the robot that is connected; `robot` is that one, else the one that was last.

        `on_command` gets what was sent to the robot: driver, m/s, rad/s, ms to live.
        `must_stand` says why the robot may not move, in a sentence; empty when it may. `other_station` names the one
        that drives it, as the robot says: it would refuse our commands. `why_alone` says why no robot is connected.
        """
        self._why_alone = why_alone
        self._other_station = other_station
        self._must_stand = must_stand
        self._on_command = on_command
        self._link = link
        self._config = config
        self._capabilities = capabilities
        self._robot = robot
        self._holds = Holds()
        self._on_driver = on_driver
        self._on_silence = on_silence
        self._now_ns = now_ns
        self._lease: DriverLease[str] = DriverLease(round(config.lease_s * 1e9))
        self._notified: str | None = None  # the driver that `on_driver` heard of last
        self._command: _Command | None = None
        self._sent_ns = 0
        self._changed = asyncio.Event()
        self._head = CameraHead()

    @property
    def driver(self) -> str | None:
        return self._lease.driver(self._now_ns())

    def has_wheel(self, driver: str) -> bool:
        """This driver has it here, and the robot has not said that another station drives it."""
        return self.driver == driver and self._other_station() is None

    @property
    def lease_left_s(self) -> float:
        """For how long the driver keeps the wheel without another word."""
        return self._lease.left_ns(self._now_ns()) * 1e-9

    @property
    def is_moving(self) -> bool:
        """A command other than standing still is held."""
        return self._command is not None

    @property
    def head_is_centred(self) -> bool:
        """The camera was told to look straight ahead, as its calibration says."""
        return self._head.is_centred

    @property
    def looks_ahead(self) -> bool:
        """Whether it has also had the time to get there: only then is the camera where the calibration says."""
        return self._head.looks_ahead(self._now_ns())

    def centre_head(self) -> None:
        """Let the camera look straight ahead, whoever drives."""
        if not self.head_is_centred and self._link.point(*AHEAD):
            self._head.turn(*AHEAD, self._now_ns())

    def drive(self, driver: str, linear: float, angular: float, ttl_ms: int, age_ms: int = 0) -> None:
        """Hold a velocity (m/s, rad/s) for `ttl_ms`. Takes the wheel when it is free.

        Args:
            age_ms: how long ago the driver said it: what a slow network adds to its life is counted from then.

        Raises:
            NoRobot, NotCapable, NotDriver (another one or another station drives), OutOfRange, Conflict (was stopped
                and holds on, began to drive another robot and holds on, or must stand): in words for a person.
        """
        is_still = linear == 0.0 and angular == 0.0
        is_same_robot = self._hear(driver, min(max(ttl_ms, 0), MAX_TTL_MS), is_still=is_still)
        able = self._require_drive()
        _check("linear", linear, able.max_linear_m_s, "m/s")
        _check("angular", angular, able.max_angular_rad_s, "rad/s")
        if not 1 <= ttl_ms <= MAX_TTL_MS:
            raise OutOfRange(f"ttl_ms {ttl_ms} is outside 1..{MAX_TTL_MS}; repeat the command instead")
        if not is_still and (reason := self._must_stand()):
            raise Conflict(reason)
        if not is_still:  # letting go is heard whoever drives
            self._require_robot_for_us()
        _require_same(is_same_robot)
        verdict = self._lease.command(_named(driver), is_still, self._now_ns(), ttl_ms * 1_000_000)
        self._require_wheel(verdict != "taken")
        if verdict == "stopped":
            raise Conflict("somebody else stopped the robot; let go of the joystick once, then drive on")
        first_ms = min(ttl_ms, MAX_DRIVE_TTL_MS)
        if not self._link.drive(linear, angular, first_ms, max(first_ms, MAX_DRIVE_TTL_MS - age_ms)):
            raise NoRobot("the robot is not connected just now; the link comes back by itself")
        self._on_command(driver, linear, angular, ttl_ms)
        self._sent_ns = self._now_ns()
        until_ns = self._now_ns() + ttl_ms * 1_000_000
        self._command = None if is_still else _Command(linear, angular, until_ns, self._robot())
        self._changed.set()

    def note_late(self, driver: str) -> None:
        """A velocity of this driver came too late to count: what it has to let go for goes on holding."""
        self._hear(driver)
        self._lease.hear_holding(driver, self._now_ns())

    def is_held_by(self, driver: str) -> bool:
        """This driver's command moves the robot now."""
        return self.is_moving and self.driver == driver

    def stop(self, by: str | None = None, *, until_confirmed: bool = False) -> bool:
        """Motors off now. Anyone may say it, also one who does not drive: then the driver must let go first.

        Args:
            by: who says it; None is the station itself.
            until_confirmed: sent again over each new connection until the robot has confirmed it.
        Returns:
            False when no robot is connected.
        """
        self._command = None
        if by is not None:
            self._holds.let_go(by)
        is_sent = self._link.stop(until_confirmed=until_confirmed)  # before all else
        self._lease.stop(by, self._now_ns())
        self._on_command(by or "station", 0.0, 0.0, 0)
        return is_sent

    def point(self, driver: str, pan: float, tilt: float) -> None:
        """Point the camera head (rad). Needs the wheel, as driving does."""
        is_same_robot = self._hear(driver)
        able = self._require_robot()
        if not able.pan_tilt:
            raise NotCapable("this robot has no pan-tilt head")
        _check("pan", pan, math.pi, "rad")
        _check("tilt", tilt, math.pi, "rad")
        self._require_robot_for_us()
        _require_same(is_same_robot)
        self._require_wheel(self._lease.claim(_named(driver), self._now_ns()))
        if not self._link.point(pan, tilt):
            raise NoRobot("the robot is not connected just now; the link comes back by itself")
        self._head.turn(pan, tilt, self._now_ns())

    def take_over(self, driver: str) -> None:
        """Become the driver, whoever drives, and stay so for some seconds without a word.

        The robot is stopped first: nobody inherits a moving robot.

        Raises:
            NoRobot, NotCapable: there is nothing to drive; OutOfRange: the name is empty or too long.
        """
        able = self._require_robot()
        if not able.drive and not able.pan_tilt:
            raise NotCapable("this robot can neither drive nor look around (a recorded one only replays)")
        _named(driver)
        if self.driver != driver:
            self.stop(driver)
        self._lease.take_over(driver, self._now_ns(), round(TAKE_OVER_S * 1e9))
        self._notify_driver()

    def release(self, driver: str) -> None:
        """Let go of the wheel; stops the robot when it was ours."""
        if self.driver == driver:
            self.stop(driver)
        self._lease.release(driver)
        self._holds.let_go(driver)
        self._notify_driver()

    async def run(self) -> None:
        """The timer: repeats, and stops when silent. Runs until cancelled, and stops the robot then."""
        try:
            while True:
                await self._step()
        finally:
            self._link.stop()

    async def _step(self) -> None:
        now_ns = self._now_ns()
        self._lease.listen(now_ns)
        self._holds.listen(now_ns)
        self._notify_driver()
        if self._command is not None and self._command.robot != self._robot():
            self._command = None  # it rests: nobody has told it anything
        command = self._command
        if command is not None and now_ns >= command.until_ns:
            self._command = None
            self._link.stop()
            self._on_silence("the driver went silent: stopped")
            return
        wait_ns = self._config.repeat_ms * 1_000_000
        if command is not None:
            left_ns = command.until_ns - now_ns
            if now_ns - self._sent_ns >= wait_ns:
                # One command may live longer than the protocol lets it: said again, until its time is over. Nothing is
                # given on top of that time: the connection may break now, and nobody tell the robot to stop.
                left_ms = min(-(-left_ns // 1_000_000), MAX_DRIVE_TTL_MS)
                self._link.drive(command.linear, command.angular, left_ms, left_ms)
                self._sent_ns = now_ns
            wait_ns = min(wait_ns, left_ns)
        self._changed.clear()
        with contextlib.suppress(TimeoutError):
            # Not wait_for: before Python 3.12 it can swallow a cancellation, and the station would never end.
            async with asyncio.timeout(wait_ns / 1e9):
                await self._changed.wait()

    def _hear(self, driver: str, ttl_ms: int = 0, *, is_still: bool = False) -> bool:
        """Whether a command, whatever becomes of it, is for the robot that is there now."""
        if is_still:
            self._holds.let_go(driver)
            return True
        return self._holds.hear(driver, self._robot(), self._now_ns(), ttl_ms * 1_000_000)

    def _require_robot(self) -> Capabilities:
        able = self._capabilities()
        if able is None:
            why = self._why_alone()
            raise NoRobot(
                f"no robot is connected: {why}"
                if why
                else "no robot is connected; start robot-server, or give its address with --robot"
            )
        return able

    def _require_drive(self) -> Capabilities:
        able = self._require_robot()
        if not able.drive:
            raise NotCapable("this robot cannot drive (a recorded one only replays)")
        return able

    def _require_robot_for_us(self) -> None:
        if (other := self._other_station()) is not None:
            raise NotDriver(f"another station ({other}) drives this robot; wait until it has let go for a second")

    def _require_wheel(self, is_ours: bool) -> None:
        """After a claim. Raises NotDriver."""
        if not is_ours:
            raise NotDriver(f"{self.driver} drives; take over with POST /drive/take-over")
        self._notify_driver()

    def _notify_driver(self) -> None:
        if (driver := self.driver) != self._notified:
            self._notified = driver
            self._on_driver(driver)


def _require_same(is_same_robot: bool) -> None:
    if not is_same_robot:
        raise Conflict("another robot than the one you drove is connected; let go of the joystick once, then drive on")


def _named(driver: str) -> str:
    if not 0 < len(driver) <= MAX_DRIVER_NAME:
        raise OutOfRange(f"a driver's name needs 1 to {MAX_DRIVER_NAME} characters, not {len(driver)}")
    return driver


def _check(name: str, value: float, limit: float, unit: str) -> None:
    if not math.isfinite(value) or abs(value) > limit + 1e-9:
        raise OutOfRange(f"{name} {value} is outside -{limit:g}..{limit:g} {unit}")


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
