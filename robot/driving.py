"""Who may drive, and which of its commands count. Pure: time is an argument."""

from __future__ import annotations

from dataclasses import dataclass

from shared.clock import RemoteClock
from shared.messages import Drive

LEASE_NS = 1_000_000_000  # who has not commanded for so long gives the wheel away
RELEASE_NS = 500_000_000  # after a stop by somebody else the driver must have let go for so long, or say zero once
SETTLING_NS = 50_000_000  # a held-up burst is read at once; what comes so much later shows how late the burst was


@dataclass
class DriverLease:
    """One station drives at a time: the first to command, until it falls silent or leaves."""

    driver: int | None = None  # client id
    _commanded_ns: int = 0
    _must_let_go: bool = False

    def request(self, client: int, is_zero: bool, now_ns: int) -> str:
        """May this client's command pass? Empty: yes. Otherwise the reason why not, in a sentence."""
        self.expire(now_ns)
        if self.driver is not None and self.driver != client:
            return "another station drives; wait until it has let go for a second"
        silence_ns = now_ns - self._commanded_ns
        self.driver, self._commanded_ns = client, now_ns
        if is_zero or silence_ns >= RELEASE_NS:
            self._must_let_go = False
        if self._must_let_go:
            return "somebody else stopped the robot; let go of the joystick once, then drive on"
        return ""

    def stop(self, client: int) -> None:
        """A stop by somebody who does not drive holds until the driver lets go; by the driver it just stops."""
        if self.driver is not None and client != self.driver:
            self._must_let_go = True

    def release(self, client: int) -> bool:
        """The client left or went quiet. True when it was driving."""
        if self.driver != client:
            return False
        self.driver = None
        return True

    def expire(self, now_ns: int) -> None:
        """Take the wheel from a driver who has been silent."""
        if self.driver is not None and now_ns - self._commanded_ns >= LEASE_NS:
            self.driver = None


class CommandOrder:
    """Tells fresh drive commands of one connection from old ones: out of order, or held up on the way.

    A network that froze delivers the past in one burst. How late a command is shows against the quickest arrivals of
    the last minute, the clocks' drift included, so no common clock is needed. The very first arrivals have nothing to
    be held against, and all of them may be one old burst: until SETTLING_NS later nothing counts.
    """

    def __init__(self) -> None:
        self._clock = RemoteClock()
        self._first_ns: int | None = None
        self._last_seq = -1

    def observe(self, t_station_ns: int, arrived_ns: int) -> None:
        """Something the station stamped has arrived: heartbeats show the least delay also while nobody drives."""
        if self._first_ns is None:
            self._first_ns = arrived_ns
        steps = self._clock.steps
        self._clock.add(t_station_ns, arrived_ns)
        if self._clock.steps != steps:
            self._first_ns = arrived_ns  # another clock: what was learnt of the old one says nothing

    def until_ns(self, command: Drive, arrived_ns: int) -> int | None:
        """Our time until which this command holds, counted from when it was said. None: it is old.

        Args:
            arrived_ns: when its bytes were read, the same for all that were read together.
        """
        self.observe(command.t_station_ns, arrived_ns)
        is_newest, fit = self.is_newest(command.seq), self._clock.fit
        if not is_newest or fit is None or self._first_ns is None or arrived_ns - self._first_ns < SETTLING_NS:
            return None
        until_ns = min(fit.to_local_ns(command.t_station_ns), arrived_ns) + command.ttl_ms * 1_000_000
        return until_ns if until_ns > arrived_ns else None

    def is_newest(self, seq: int) -> bool:
        """Whether this number is higher than all before: drive and stop share one count."""
        is_newest = seq > self._last_seq
        self._last_seq = max(self._last_seq, seq)
        return is_newest
