"""What one station's link carries, from what was sent and what the station confirms. No socket, no clock.

A picture needs its bytes' time on the link, plus what a few bytes need there and back. Both are seen: the time of a
few bytes while no picture is on its way, and the time of each picture. One that was sent behind another one begins
when that one's last byte has arrived.
Source of measuring a bottleneck by what is delivered: Cardwell et al., "BBR", ACM Queue 14(5), 2016.
"""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

KEPT_FRAMES = 15  # a second of pictures, or two
# A lost packet holds up a picture, and those behind it come at once: the middle one is not fooled by a few of either.
# Where they are many it is; so much more than was carried in all, waiting for lost packets included, is not believed.
RECOVERED = 1.5
LONGEST_SERVICE_NS = 300_000_000  # an outage is no rate
KEPT_TRIPS = 50  # of a few bytes: some seconds
# Messages under way that are remembered, of pictures and of others each. A link holds fewer; a station that confirms no
# bytes leaves all of them under way.
KEPT_UNDER_WAY = 2048
# No way gets so much shorter from one message to the next: a clock stood still, as that of a computer that slept.
CLOCK_STEP_NS = 100_000_000
LEAST_SERVICE_NS = 1_000_000  # two event loops cannot tell less
LEAST_SPREAD_NS = 100_000  # pieces that come in one transmission


@dataclass(frozen=True, slots=True)
class LinkEstimate:
    """What a station's link carries at present."""

    bytes_per_s: float  # while something is on its way all the time
    trip_ns: int  # of a few bytes, until the station's word of them is back
    other_bytes_per_s: float  # what is sent beside pictures

    @property
    def held_bytes(self) -> float:
        """What the link holds by itself; more than that waits in a queue."""
        return self.bytes_per_s * self.trip_ns * 1e-9


@dataclass(frozen=True, slots=True)
class _Sent:
    end: int  # bytes sent on this connection with it
    num_bytes: int
    t_ns: int
    met_frame: bool  # a picture was on its way before it
    left_ns: int  # when it has left us, as far as the link is known


class LinkMeter:
    """Counts the bytes of one connection."""

    def __init__(self) -> None:
        self._frames: deque[_Sent] = deque(maxlen=KEPT_UNDER_WAY)  # the pictures under way
        self._others: deque[_Sent] = deque(maxlen=KEPT_UNDER_WAY)  # and what else is
        self._trips_ns: deque[int] = deque(maxlen=KEPT_TRIPS)
        # The way there and the way back, by two clocks: each is off by what lies between them.
        self._delays_ns: deque[int] = deque(maxlen=KEPT_TRIPS)
        self._returns_ns: deque[int] = deque(maxlen=KEPT_TRIPS)
        self._sent = self._confirmed = 0
        self._served: deque[tuple[int, int]] = deque(maxlen=KEPT_FRAMES)  # bytes and time of the last pictures
        self._rates: deque[float] = deque(maxlen=KEPT_FRAMES)  # bytes per ns of the same
        self._frame_confirmed_ns = 0
        self._other_bytes = 0  # beside pictures since the last picture
        self._last_frame_ns: int | None = None
        self._other_rate = 0.0
        # When the newest of what the station has was sent: what it says from now on, it says later.
        self.has_heard_ns: int | None = None
        self.estimate: LinkEstimate | None = None  # None: no picture has been confirmed yet

    @property
    def unconfirmed_bytes(self) -> int:
        return self._sent - self._confirmed

    @property
    def trip_ns(self) -> int:
        """Of a few bytes, there and back; 0: not known."""
        return _middle(self._trips_ns)

    def is_busy(self, now_ns: int) -> bool:
        """Whether a picture has not left yet, as far as the link is known."""
        return bool(self._frames) and (self.estimate is None or now_ns < self._frames[-1].left_ns)

    def has_room(self, now_ns: int) -> bool:
        """Whether another picture would not wait behind one: at most one is on its way beyond what the link holds.

        The word of a picture's arrival takes its time; a picture that should have left by now counts as if it had, but
        no more than one, and not while one is overdue.
        """
        if not self._frames:
            return True
        if self.estimate is None or self.is_busy(now_ns):
            return False
        if now_ns > self._frames[0].left_ns + 2 * self.estimate.trip_ns:
            return False
        return self.unconfirmed_bytes <= self.estimate.held_bytes + self._frames[-1].num_bytes

    def send(self, num_bytes: int, is_frame: bool, now_ns: int) -> None:
        """These bytes are handed to the kernel."""
        self._sent += num_bytes
        service_ns = 0 if self.estimate is None else round(num_bytes / self.estimate.bytes_per_s * 1e9)
        begin_ns = max(now_ns, self._frames[-1].left_ns) if self._frames else now_ns
        sent = _Sent(self._sent, num_bytes, now_ns, bool(self._frames), begin_ns + service_ns)
        if is_frame:
            self._frames.append(sent)
            self._measure_others(now_ns)
        else:
            self._others.append(sent)
            self.note_beside(num_bytes)

    def note_beside(self, num_bytes: int) -> None:
        """These bytes go the same way beside the pictures, perhaps by another connection."""
        self._other_bytes += num_bytes

    @property
    def is_settled(self) -> bool:
        """The estimate is of as many pictures as it ever is."""
        return len(self._served) == KEPT_FRAMES

    def confirm_frame(self, now_ns: int) -> None:
        """A station of before `Received.num_bytes` has one more picture, and all that was sent before it."""
        if self._frames:
            self.confirm(self._frames[0].end, 0, now_ns)

    def lose(self, num_bytes: int) -> None:
        """The pictures within that many bytes did not arrive, and do not any more."""
        self._confirmed = max(self._confirmed, num_bytes)
        _pop_confirmed(self._frames, num_bytes)

    def confirm(
        self, num_bytes: int, held_ns: int, now_ns: int, t_station_ns: int = 0, spread: tuple[float, int] | None = None
    ) -> None:
        """The station has that many bytes of this connection, the last of them since `held_ns`.

        Args:
            t_station_ns: when it read these, by its own clock: how long this word of it took says nothing of the link's
                rate. 0: not told.
            spread: of a picture that came in pieces: bytes behind the first piece, and ns from that to the last one.
                Jitter moves both ends alike, and a way's delay need not be known.
        """
        trip_end_ns = now_ns - max(0, held_ns)
        read_ns = t_station_ns or trip_end_ns
        self._confirmed = max(self._confirmed, min(num_bytes, self._sent))
        frames, others = _pop_confirmed(self._frames, num_bytes), _pop_confirmed(self._others, num_bytes)
        for sent in (*frames[-1:], *others[-1:]):
            self.has_heard_ns = max(sent.t_ns, self.has_heard_ns or sent.t_ns)
        newest_ns = max((sent.t_ns for sent in (*frames[-1:], *others[-1:])), default=None)
        if newest_ns is not None:
            self._follow_clocks(read_ns - newest_ns, trip_end_ns - read_ns)
        for frame in frames:
            self._note_frame(frame, read_ns, spread if frame is frames[-1] else None)
        if others and not (frames and frames[-1].end > others[-1].end):
            self.note_trip(others[-1].t_ns, read_ns, trip_end_ns, others[-1].met_frame)

    def note_trip(self, sent_ns: int, read_ns: int, end_ns: int, met_frame: bool) -> None:
        """A few bytes were read by the station's clock at `read_ns`, and the word of it was here at `end_ns`."""
        trip_ns = max(0, end_ns - sent_ns)
        # Behind a picture it may have waited; what was quick all the same was not held up.
        if not met_frame or not self._trips_ns or trip_ns < self.trip_ns:
            self._trips_ns.append(trip_ns)
            self._delays_ns.append(read_ns - sent_ns)
            self._returns_ns.append(end_ns - read_ns)

    def _follow_clocks(self, there_ns: int, back_ns: int) -> None:
        """Where a clock stood still, what was learnt of the delays is moved by as much.

        While the station's did, the way there looks shorter; while ours did, the way back.
        """
        ways = ((there_ns, self._delays_ns), (back_ns, self._returns_ns))
        if not any(known and way_ns < min(known) - CLOCK_STEP_NS for way_ns, known in ways):
            return
        step_ns = back_ns - _middle(self._returns_ns)
        self._frame_confirmed_ns -= step_ns
        for known, by_ns in ((self._delays_ns, -step_ns), (self._returns_ns, step_ns)):
            moved = [way_ns + by_ns for way_ns in known]
            known.clear()
            known.extend(moved)

    def _note_frame(self, frame: _Sent, read_ns: int, spread: tuple[float, int] | None) -> None:
        # The middle delay: jitter belongs to it, or every picture would be blamed for it.
        begin_ns = max(frame.t_ns + _middle(self._delays_ns), self._frame_confirmed_ns)
        self._frame_confirmed_ns = read_ns
        service_ns = min(max(read_ns - begin_ns, LEAST_SERVICE_NS), LONGEST_SERVICE_NS)
        self._served.append((frame.num_bytes, service_ns))
        num_bytes, took_ns = spread or (frame.num_bytes, service_ns)
        self._rates.append(num_bytes / max(took_ns, LEAST_SPREAD_NS))
        self.estimate = LinkEstimate(self._rate(), self.trip_ns, self._other_rate)

    def _rate(self) -> float:
        """Bytes a second, of the last pictures."""
        middle = statistics.median_low(self._rates)
        overall = sum(num_bytes for num_bytes, _ in self._served) / sum(ns for _, ns in self._served)
        return min(middle, RECOVERED * overall) * 1e9

    def _measure_others(self, now_ns: int) -> None:
        if self._last_frame_ns is not None and now_ns > self._last_frame_ns:
            rate = self._other_bytes / (now_ns - self._last_frame_ns) * 1e9
            self._other_rate = 0.9 * self._other_rate + 0.1 * rate
        self._last_frame_ns, self._other_bytes = now_ns, 0


def _middle(values_ns: Collection[int]) -> int:
    return round(statistics.median(values_ns)) if values_ns else 0


def _pop_confirmed(under_way: deque[_Sent], num_bytes: int) -> list[_Sent]:
    """What ends within the first `num_bytes` of the connection, the oldest first."""
    confirmed = []
    while under_way and under_way[0].end <= num_bytes:
        confirmed.append(under_way.popleft())
    return confirmed
