"""What stations' commands do to the robot: who may drive, what counts, what is refused and why."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Literal

import msgspec

from robot.config import DriveConfig
from robot.devices.ports import DeviceSet
from robot.head import CameraHead
from robot.watchdog import MotorWatchdog, Velocity
from shared.clock import MAX_CRYSTAL_DRIFT, RemoteClock
from shared.errors import HardwareError
from shared.lease import DriverLease
from shared.messages import (
    Capabilities,
    Drive,
    ErrorCode,
    ErrorNotice,
    Heartbeat,
    Hijack,
    PanTilt,
    StationMessage,
    Stop,
)

logger = logging.getLogger(__name__)
LEASE_NS = 1_000_000_000  # who has not commanded for so long gives the wheel away
SETTLING_NS = 50_000_000  # a held-up burst is read at once; what comes so much later shows how late the burst was
PAUSE_NS = 20_000_000  # a line through the quickest arrivals is not that wrong; a clock that stood still is
# Of its life that a command must have left to start motors. One that was said within half a life of another has less
# when that other one is over, so the last words of a driver who falls silent start nothing.
STARTING_SHARE = 0.5
# From when a command may have been said at the earliest. A life begins with the quickest arrival, and how long that one
# was on its way nobody knows: at most as long as there and back. Motors stop within half a second, threads included.
MAX_HOLD_NS = 450_000_000
MAX_AHEAD = 1024  # commands by datagram that the connection has not brought yet: it is dead long before
About = Literal["hijack", "calibration"] | msgspec.UnsetType  # which question a notice answers


class CommandOrder:
    """Tells fresh drive commands of one connection from old ones: out of order, or held up on the way.

    A network that froze delivers the past in one burst. How late a command is shows against the quickest arrivals of
    the last minute, the clocks' drift included, so no common clock is needed. The very first arrivals have nothing to
    be held against, and all of them may be one old burst: until SETTLING_NS later nothing counts.

    Where the station's clock stood still (it slept, or was a machine that was halted) all it says seems late from then
    on. But what it says after it has heard us it says later than we spoke: that shows the pause, and no network can
    feign it. All is learnt anew then.

    What is late by the same from the beginning on looks quick. But a command was said after what the station had heard
    of us by then: between that and the quickest arrivals it was said, and it holds for MAX_HOLD_NS from the former.

    Commands come by datagram too, in any order. These may be held up for as long as somebody likes while the
    connection goes on: they never show a pause, and what was said before one counts no more. Of a command's two copies
    the first to come counts; the connection keeps the order, so up to what it has brought a datagram is the later one.
    """

    def __init__(self) -> None:
        self._clock = RemoteClock(MAX_CRYSTAL_DRIFT)
        self._heard_clock = RemoteClock(MAX_CRYSTAL_DRIFT)  # our clock as the station hears it, the way there included
        self._first_ns: int | None = None
        self._last_seq = -1  # of drive and stop
        self._heard_seq = -1  # of heartbeats, too: all share one count
        self._has_heard_ns: int | None = None
        self._newest_ns: int | None = None  # station's time: newest said, by either way
        self._newest_datagram_ns: int | None = None
        self._anew_ns: int | None = None  # station's time: what was said before is of a clock that we know no more
        self._by_connection = -1  # newest number that it brought
        self._by_datagram: set[int] = set()  # numbers that were taken so and are still to come by the connection

    def note_heard(self, sent_ns: int) -> None:
        """The station has heard what we sent then: what comes from now on it says later."""
        self._has_heard_ns = sent_ns

    def observe(self, t_station_ns: int, arrived_ns: int, *, is_datagram: bool = False) -> None:
        """Something the station stamped has arrived: heartbeats show the least delay also while nobody drives."""
        if not is_datagram and self._has_paused(t_station_ns):
            self._clock, self._first_ns = RemoteClock(MAX_CRYSTAL_DRIFT), None
            self._heard_clock = RemoteClock(MAX_CRYSTAL_DRIFT)
            self._anew_ns = self._newest_ns = t_station_ns
            self._newest_datagram_ns = None
        if not is_datagram and self._has_heard_ns is not None:
            self._heard_clock.add(self._has_heard_ns, t_station_ns)
        overtaking_ns = self._newest_ns if is_datagram else self._newest_datagram_ns
        if overtaking_ns is not None and t_station_ns < overtaking_ns:
            return  # it says nothing of the quickest way, and must not look like a clock that was set
        self._newest_ns = t_station_ns
        if is_datagram:
            self._newest_datagram_ns = t_station_ns
        if self._first_ns is None:
            self._first_ns = arrived_ns
        steps = self._clock.steps
        self._clock.add(t_station_ns, arrived_ns)
        if self._clock.steps != steps:
            self._first_ns = arrived_ns  # another clock: what was learnt of the old one says nothing
            self._heard_clock = RemoteClock(MAX_CRYSTAL_DRIFT)
            self._anew_ns = t_station_ns

    def _has_paused(self, t_station_ns: int) -> bool:
        fit, said_after_ns = self._clock.fit, self._has_heard_ns
        return (
            fit is not None and said_after_ns is not None and fit.to_local_ns(t_station_ns) + PAUSE_NS < said_after_ns
        )

    def is_first(self, seq: int, *, is_datagram: bool) -> bool:
        """Whether this is the first copy of a drive or stop to come."""
        if is_datagram:
            if seq <= self._by_connection or seq in self._by_datagram:
                return False
            self._by_datagram.add(seq)
            if len(self._by_datagram) > MAX_AHEAD:  # a copy of it would count again: a drive is too old, a stop stops
                self._by_datagram.remove(min(self._by_datagram))
            return True
        is_first = seq not in self._by_datagram
        self._by_connection = max(self._by_connection, seq)
        self._by_datagram = {number for number in self._by_datagram if number > self._by_connection}
        return is_first

    def until_ns(self, command: Drive, arrived_ns: int, *, is_datagram: bool = False) -> int | None:
        """Our time until which this command holds, counted from when it was said. None: it is old.

        Args:
            arrived_ns: when its bytes were read, the same for all that were read together.
        """
        self.observe(command.t_station_ns, arrived_ns, is_datagram=is_datagram)
        if is_datagram and self._anew_ns is not None and command.t_station_ns < self._anew_ns:
            return None
        is_newest, fit = self.is_newest(command.seq), self._clock.fit
        if not is_newest or fit is None or self._first_ns is None or arrived_ns - self._first_ns < SETTLING_NS:
            return None
        until_ns = min(fit.to_local_ns(command.t_station_ns), arrived_ns) + command.ttl_ms * 1_000_000
        if (heard := self._heard_clock.fit) is not None:
            until_ns = min(until_ns, heard.to_remote_ns(command.t_station_ns) + MAX_HOLD_NS)
        return until_ns if until_ns > arrived_ns else None

    def count(self, seq: int) -> bool:
        """Count a number that was heard. False where something was said between it and the newest before."""
        is_next = self._heard_seq < 0 or seq <= self._heard_seq + 1
        self._heard_seq = max(self._heard_seq, seq)
        return is_next

    def is_newest(self, seq: int) -> bool:
        """Whether this number is higher than all before: drive and stop share one count."""
        is_newest = seq > self._last_seq
        self._last_seq = max(self._last_seq, seq)
        return is_newest


@dataclass
class CommandDesk:
    """Carries out commands of all stations, one driver at a time."""

    devices: DeviceSet
    watchdog: MotorWatchdog | None  # None: a robot without motors
    limits: DriveConfig
    # By station: one that made its connection anew is not somebody else, and its own stop of before is letting go.
    lease: DriverLease[str] = field(default_factory=lambda: DriverLease(LEASE_NS))
    refused: int = 0
    _handled_by: set[int] = field(default_factory=set)  # clients at which somebody handles the robot
    _orders: dict[int, CommandOrder] = field(default_factory=dict)  # client id → order of its commands
    _stations: dict[int, str] = field(default_factory=dict)  # client id → who speaks by it
    _driven_by: int | None = None  # client by which the wheel was claimed last
    head: CameraHead | None = field(init=False)  # None: the camera is fixed

    def __post_init__(self) -> None:
        servos = self.devices.pan_tilt
        self.head = None if servos is None else CameraHead(servos.point, self.devices.calibration.head)

    def capabilities(self) -> Capabilities:
        """What this robot can do, for the hello."""
        return Capabilities(
            camera=self.devices.camera is not None,
            imu=self.devices.imu is not None,
            drive=self.watchdog is not None,
            pan_tilt=self.head is not None,
            battery=self.devices.battery is not None,
            hijack=self.devices.hijack is not None,
            max_linear_m_s=self.limits.max_linear_m_s,
            max_angular_rad_s=self.limits.max_angular_rad_s,
        )

    def join(self, client: int, station: str) -> None:
        """A connection is this station's. Of an older one, which does not say who it is, each is somebody else."""
        self._stations[client] = station

    def _station(self, client: int) -> str:
        return self._stations.get(client, f"connection {client}")

    def note_heard(self, client: int, sent_ns: int) -> None:
        """This station has heard what we sent then, and all before it."""
        self._order(client, sent_ns).note_heard(sent_ns)

    def note_time(self, client: int, t_station_ns: int, now_ns: int) -> None:
        """A datagram has come that the station stamped."""
        self._order(client, now_ns).observe(t_station_ns, now_ns, is_datagram=True)

    def listen(self, now_ns: int) -> None:
        """To be called several times a second: silence counts only while we listen."""
        self.lease.listen(now_ns)

    def handle(
        self, client: int, message: StationMessage, now_ns: int, *, is_datagram: bool = False
    ) -> ErrorNotice | None:
        """Carry out one message; the answer is a notice when it was refused.

        Args:
            now_ns: when its bytes were read, the same for all that were read together.
            is_datagram: a drive or stop that is on its way by the connection as well.
        """
        order = self._order(client, now_ns)
        match message:
            case Heartbeat():
                order.count(message.seq)
                order.observe(message.t_station_ns, now_ns)
                return None
            case Drive():
                return self._drive(client, order, message, now_ns, is_datagram)
            case Stop() if not order.is_first(message.seq, is_datagram=is_datagram):
                return None
            case Stop():
                return self._stop(client, order, message, now_ns)
            case PanTilt():
                return self._point(client, message, now_ns)
            case Hijack():
                return self._hijack(client, message, now_ns)
            case _:
                return None

    def is_driven_by(self, client: int, now_ns: int) -> bool:
        """Whether this connection's station drives, by whichever connection."""
        return self.lease.driver(now_ns) == self._station(client)

    @property
    def is_handled(self) -> bool:
        """Somebody is beside the robot, and no station drives it."""
        return bool(self._handled_by)

    def keep_standing(self, client: int, must_stand: bool) -> None:
        """Whether somebody handles the robot at this station: then no station drives it."""
        if not must_stand:
            self._handled_by.discard(client)
        elif client not in self._handled_by:
            self._handled_by.add(client)
            if self.watchdog is not None:
                self.watchdog.stop()

    def leave(self, client: int) -> None:
        """The connection is gone: if the station drove by it, the motors stop now."""
        self._orders.pop(client, None)
        self.go_quiet(client)
        self._stations.pop(client, None)

    def go_quiet(self, client: int) -> None:
        """Nothing was heard of the station by this connection for a while: it neither drives nor keeps others from it.

        Where the station drives by another connection, it goes on.
        """
        self._handled_by.discard(client)
        if self._driven_by == client and self.lease.leave(self._station(client)) and self.watchdog is not None:
            self.watchdog.stop()

    def _order(self, client: int, now_ns: int) -> CommandOrder:
        if client not in self._orders:
            self._orders[client] = CommandOrder()
            # It may be one that was stopped, whose connection broke.
            self.lease.hear_holding(self._station(client), now_ns)
        return self._orders[client]

    def _drive(
        self, client: int, order: CommandOrder, message: Drive, now_ns: int, is_datagram: bool
    ) -> ErrorNotice | None:
        if self.watchdog is None:
            return self._refuse("not_capable", "this robot has no motors")
        station, wish = self._station(client), Velocity(message.linear, message.angular)
        is_first = order.is_first(message.seq, is_datagram=is_datagram)
        is_next = order.count(message.seq)
        until_ns = order.until_ns(message, now_ns, is_datagram=is_datagram)
        if not is_first:
            return None
        if not wish.is_zero and (until_ns is None or not is_next):
            self.lease.hear_holding(station, now_ns)  # a network that froze is no driver who let go
        if until_ns is None:
            if wish.is_zero and self.lease.last_driver == station:
                self.watchdog.stop()  # letting go counts however late it comes
            return None  # the past needs no answer; what counts comes next
        limits = self.limits
        is_within = abs(message.linear) <= limits.max_linear_m_s and abs(message.angular) <= limits.max_angular_rad_s
        if not is_within:
            return self._refuse(
                "out_of_range",
                f"drive command ({message.linear:g} m/s, {message.angular:g} rad/s) exceeds this robot's limits"
                f" of {limits.max_linear_m_s:g} m/s and {limits.max_angular_rad_s:g} rad/s",
            )
        if self.is_handled and not wish.is_zero:
            return self._refuse("not_allowed", "somebody handles the robot to calibrate it; it drives again after that")
        verdict = self.lease.command(station, wish.is_zero, now_ns)
        if verdict != "taken":
            self._driven_by = client
        match verdict:
            case "taken":
                return self._refuse("not_driver", "another station drives; wait until it has let go for a second")
            case "stopped":
                reason = "somebody else stopped the robot; let go of the joystick once, then drive on"
                return self._refuse("not_driver", reason)
            case "granted":
                pass
        # Of a driver who has fallen silent a last command may come when the one before it has run out, and would start
        # the motors for what is left of its life. A driver who goes on says the next one soon: that starts them.
        starts_until_ns = until_ns - round(STARTING_SHARE * message.ttl_ms * 1_000_000)
        if not self.watchdog.command(wish, until_ns, starts_until_ns):
            return self._refuse("device", "the motors are shut down; restart robot-server")
        return None

    def _stop(self, client: int, order: CommandOrder, message: Stop, now_ns: int) -> ErrorNotice | None:
        order.count(message.seq)
        order.is_newest(message.seq)  # commands sent before it are old now
        # A station stops by itself, too: its own stop is no letting go.
        if not self.is_driven_by(client, now_ns):
            self.lease.stop(None, now_ns)
        if self.watchdog is not None:
            self.watchdog.stop()
            if self.watchdog.stop_fault:
                reason = f"the motors do not answer STOP ({self.watchdog.stop_fault}); it is repeated until they do"
                logger.error("%s", reason)
                return notice("device", reason)
        return None

    def _point(self, client: int, message: PanTilt, now_ns: int) -> ErrorNotice | None:
        if self.head is None:
            return self._refuse("not_capable", "this robot has no pan-tilt head")
        if self._is_driven_by_another(client, now_ns):
            return self._refuse("not_driver", "another station drives; it also points the camera")
        try:
            self.head.look(message.pan, message.tilt, now_ns)
        except HardwareError as exc:
            return self._refuse("device", f"the pan-tilt head does not obey: {exc}")
        return None

    def _hijack(self, client: int, message: Hijack, now_ns: int) -> ErrorNotice | None:
        if self.devices.hijack is None:
            return self._refuse("not_capable", "only simulated robots can be hijacked", about="hijack")
        if self._is_driven_by_another(client, now_ns):
            reason = "another station drives; it alone may hijack the robot"
            return self._refuse("not_driver", reason, about="hijack")
        try:
            if message.anywhere:
                self.devices.hijack.hijack_anywhere()
            else:
                self.devices.hijack.hijack(message.x, message.y, message.yaw)
        except ValueError as exc:
            return self._refuse("out_of_range", f"cannot put the robot there: {exc}", about="hijack")
        return None

    def _is_driven_by_another(self, client: int, now_ns: int) -> bool:
        return self.lease.driver(now_ns) not in (None, self._station(client))

    def _refuse(self, code: ErrorCode, reason: str, about: About = msgspec.UNSET) -> ErrorNotice:
        self.refused += 1
        logger.info("refused: %s", reason)
        return notice(code, reason, about=about)


def notice(code: ErrorCode, message: str, fatal: bool = False, about: About = msgspec.UNSET) -> ErrorNotice:
    """An error notice whose sentence fits its limit."""
    return ErrorNotice(code=code, message=message[:1000], fatal=fatal, about=about)
