"""How the network between station and robot is, for whoever drives: in numbers and in words. Time is an argument."""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass
from typing import Literal

NetworkGrade = Literal["none", "silent", "good", "slow", "bad"]
KEPT = 20  # two seconds of heartbeats, one of pictures
KEPT_PAUSES = 100  # at a tick each 25 ms, longer than any delay that counts
# From a thing's happening to the robot's reaction: its picture's way here, and the command's way back.
GOOD_LOOP_MS = 250.0  # people drive by this as by sight
SLOW_LOOP_MS = 600.0  # and by this only slowly
LEAST_RATE_HZ = 8.0
STANDING_TRIP_MS = 325.0  # where no heartbeat is quicker, no robot starts its motors: stops would come too late


@dataclass(frozen=True, slots=True)
class NetworkState:
    """What a driver needs to know of the network."""

    grade: NetworkGrade
    sentence: str  # for a person
    round_trip_ms: float | None = None  # of nine in ten heartbeats at most
    picture_age_ms: float | None = None  # of nine in ten pictures at most, on arrival
    computer_busy: bool = False  # what is late is so by the station's computer, not by a network


_OF_A_NETWORK = ("slow network", "bad network", "come closer to the access point")
_OF_ONE_MACHINE = ("this computer is busy", "this computer is too busy", "let it do less")
_OF_THE_STATION = ("the station's computer is busy", "the station's computer is too busy", "let it do less")
NOT_CONNECTED = NetworkState("none", "not connected yet")


class OwnPauses:
    """When this program came late to what it had set itself to do: its computer was busy, whatever the network did."""

    def __init__(self) -> None:
        self._pauses_ns: deque[tuple[int, int]] = deque(maxlen=KEPT_PAUSES)  # from, until
        self._due_ns: int | None = None

    def expect(self, due_ns: int) -> None:
        """From then on the program is late, until it notes that it came."""
        self._due_ns = due_ns

    def note(self, now_ns: int) -> None:
        if self._due_ns is not None and now_ns > self._due_ns:
            self._pauses_ns.append((self._due_ns, now_ns))
        self._due_ns = None

    def within_ns(self, since_ns: int, now_ns: int) -> int:
        """How much of that time was paused: at most so much later is what arrives now because of us."""
        pauses = list(self._pauses_ns)
        if self._due_ns is not None:  # what waited through a pause is read before the program notes that it is late
            pauses.append((self._due_ns, now_ns))
        return sum(max(0, min(end, now_ns) - max(begin, since_ns)) for begin, end in pauses)


class RecentDelays:
    """The last heartbeats' round trips and pictures' ages."""

    def __init__(self) -> None:
        self._round_trips_ns: deque[int] = deque(maxlen=KEPT)
        self._ages_ns: deque[int] = deque(maxlen=KEPT)
        self._own_trips_ns: deque[int] = deque(maxlen=KEPT)  # what this computer's pauses can have made of them
        self._own_ages_ns: deque[int] = deque(maxlen=KEPT)
        self._least_ns: int | None = None

    def add_round_trip(self, delay_ns: int, own_ns: int = 0) -> None:
        """`own_ns`: for how long of it this program did not get to run."""
        self._round_trips_ns.append(delay_ns)
        self._own_trips_ns.append(own_ns)
        self._least_ns = delay_ns if self._least_ns is None else min(self._least_ns, delay_ns)

    def add_picture(self, age_ns: int, own_ns: int = 0) -> None:
        self._ages_ns.append(age_ns)
        self._own_ages_ns.append(own_ns)

    @property
    def _is_mostly_own(self) -> bool:
        """Whether of all that time this computer's own pauses took more than everything else did."""
        own_ns = sum(self._own_trips_ns) + sum(self._own_ages_ns)
        return 2 * own_ns > sum(self._round_trips_ns) + sum(self._ages_ns)

    @property
    def round_trip_ms(self) -> float | None:
        return _most_of(self._round_trips_ns)

    @property
    def picture_age_ms(self) -> float | None:
        return _most_of(self._ages_ns)

    @property
    def late_ms(self) -> int:
        """By how much a command may come later than the quickest ones, all of it blamed on its own way."""
        if self._least_ns is None or self.round_trip_ms is None:
            return 0
        return max(0, round(self.round_trip_ms - self._least_ns * 1e-6))

    def state(self, picture_rate_hz: float, is_quiet: bool, is_same_machine: bool = False) -> NetworkState:
        """How the network of a connected robot is. On one machine what is late is the machine's own business."""
        trip_ms, age_ms = self.round_trip_ms, self.picture_age_ms
        loop_ms = (trip_ms or 0.0) + (age_ms or 0.0)
        is_rare = age_ms is not None and picture_rate_hz < LEAST_RATE_HZ
        if is_quiet:
            return NetworkState("silent", "the robot has said nothing for a second", trip_ms, age_ms)
        if loop_ms <= GOOD_LOOP_MS and not is_rare:
            return NetworkState("good", "the network is good", trip_ms, age_ms)
        is_busy = is_same_machine or self._is_mostly_own
        words = _OF_ONE_MACHINE if is_same_machine else _OF_THE_STATION if is_busy else _OF_A_NETWORK
        slow, bad, remedy = words
        is_standing = trip_ms is not None and min(self._round_trips_ns) * 1e-6 >= STANDING_TRIP_MS
        if loop_ms <= SLOW_LOOP_MS and not is_standing:
            what = f"{slow}: {self._numbers(picture_rate_hz)}; drive slowly"
            return NetworkState("slow", what, trip_ms, age_ms, is_busy)
        reason = "; the robot stands, since stops would come too late" if is_standing else ""
        what = f"{bad}: {self._numbers(picture_rate_hz)}{reason}; {remedy}"
        return NetworkState("bad", what, trip_ms, age_ms, is_busy)

    def _numbers(self, picture_rate_hz: float) -> str:
        parts = []
        if (age_ms := self.picture_age_ms) is not None:
            parts.append(f"{picture_rate_hz:.0f} pictures a second, {age_ms:.0f} ms old")
        if (trip_ms := self.round_trip_ms) is not None:
            parts.append(f"{trip_ms:.0f} ms there and back")
        return ", ".join(parts)


def _most_of(delays_ns: deque[int]) -> float | None:
    """Nine in ten are at most that, in ms."""
    if len(delays_ns) < 2:
        return delays_ns[0] * 1e-6 if delays_ns else None
    return statistics.quantiles(delays_ns, n=10, method="inclusive")[-1] * 1e-6
