"""Which of a driver's commands count. Pure: time is an argument."""

from __future__ import annotations

from shared.clock import RemoteClock
from shared.messages import Drive

SETTLING_NS = 50_000_000  # a held-up burst is read at once; what comes so much later shows how late the burst was


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
