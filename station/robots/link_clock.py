"""A robot's clock as the station sees it: offset and drift from the quickest messages in both directions.

A message from the robot shows an offset that is too large by its delay, one to the robot an offset that is too small by
its delay. So the truth lies in a corridor between the least of the former and the greatest of the latter, whose middle
is right when the quickest messages of both directions took the same time. A link that is full widens the corridor on
one side; each stretch of ten seconds therefore counts the less the wider its corridor is than the narrowest one.
Source of the least delay per direction: Mills, RFC 5905, section 10 (clock filter), where it is one exchange's.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from shared.clock import MAX_CRYSTAL_DRIFT
from shared.messages import HeartbeatReply

STRETCH_NS = 10_000_000_000  # long enough for some quick messages each way, short enough that no crystal drifts far
KEPT_STRETCHES = 60  # ten minutes
LEAST_SIGMA_NS = 200_000.0  # two event loops: no stretch is known better
DRIFT_SIGMA = 50e-6  # of crystals of small computers, before anything is measured
STEP_NS = 1_000_000_000  # so far outside the corridor: a clock was set, or one machine slept


@dataclass(slots=True)
class _Stretch:
    """The corridor of ten seconds: differences `t_station - t_robot` and when they were seen, both in ns."""

    begin_ns: int
    most: tuple[int, int] | None = None  # (t_station, difference) of the quickest message from the robot
    least: tuple[int, int] | None = None  # of the quickest one to it

    def middle(self, slope: float) -> tuple[float, float, float] | None:
        """(t_station, difference there, width of the corridor along `slope`); None while one side is missing."""
        if self.most is None or self.least is None:
            return None
        width = self.most[1] - self.least[1] - slope * (self.most[0] - self.least[0])
        return (self.most[0] + self.least[0]) / 2, (self.most[1] + self.least[1]) / 2, width


@dataclass(frozen=True, slots=True)
class _Line:
    """`t_station - t_robot = difference + slope * (station - t)`, all in ns; `bound` holds at `bound_t`."""

    t_ns: float
    difference_ns: float
    slope: float = 0.0
    slope_sigma: float = DRIFT_SIGMA
    bound_ns: float = math.inf
    bound_t_ns: float = 0.0

    def at(self, t_station_ns: float) -> float:
        return self.difference_ns + self.slope * (t_station_ns - self.t_ns)


class LinkClock:
    """Collects stamps of one run of robot-server. Memory is bounded; time is an argument."""

    def __init__(self) -> None:
        self._stretches: deque[_Stretch] = deque(maxlen=KEPT_STRETCHES)
        self._epoch_ns = 0  # differences are kept relative to the first: products of whole stamps would lose digits
        self._line: _Line | None = None
        self.rtt_ns: int | None = None  # of the last heartbeat

    def add_reply(self, reply: HeartbeatReply, now_ns: int) -> None:
        inside_robot_ns = reply.t_robot_sent_ns - reply.t_robot_received_ns
        self.rtt_ns = now_ns - reply.t_station_ns - inside_robot_ns
        self._add(reply.t_station_ns, least_ns=reply.t_station_ns - reply.t_robot_received_ns)
        self.add_stamp(reply.t_robot_sent_ns, now_ns)
        self._fit()

    def add_stamp(self, t_robot_ns: int, now_ns: int) -> None:
        """Something the robot stamped when it sent it has arrived."""
        self._add(now_ns, most_ns=now_ns - t_robot_ns)

    def to_station_ns(self, t_robot_ns: int) -> int | None:
        """Station time of a robot time; None before the first arrival."""
        line = self._line
        if line is None:
            return None
        near_ns = t_robot_ns + self._epoch_ns
        return near_ns + round(line.at(near_ns) / (1.0 - line.slope))

    def offset_ns(self, now_ns: int) -> int | None:
        """t_station - t_robot at present."""
        return None if self._line is None else self._epoch_ns + round(self._line.at(now_ns))

    def bound_ns(self, now_ns: int) -> int | None:
        """By how much `offset_ns` may be wrong at most: no exchange can tell how its delay was shared.

        None while nothing was answered yet.
        """
        line = self._line
        if line is None or math.isinf(line.bound_ns):
            return None
        return round(line.bound_ns + line.slope_sigma * abs(now_ns - line.bound_t_ns))

    @property
    def drift_ppm(self) -> float | None:
        """How much faster the robot's clock runs."""
        return None if self._line is None else -self._line.slope * 1e6

    def _add(self, t_station_ns: int, *, most_ns: int | None = None, least_ns: int | None = None) -> None:
        if not self._stretches:
            self._epoch_ns = most_ns if most_ns is not None else least_ns or 0
        most = None if most_ns is None else (t_station_ns, most_ns - self._epoch_ns)
        least = None if least_ns is None else (t_station_ns, least_ns - self._epoch_ns)
        self._forget_what_contradicts(most, least)
        if not self._stretches or t_station_ns - self._stretches[-1].begin_ns >= STRETCH_NS:
            self._stretches.append(_Stretch(t_station_ns))
        stretch = self._stretches[-1]
        if most is not None and (stretch.most is None or most[1] < stretch.most[1]):
            stretch.most = most
        if least is not None and (stretch.least is None or least[1] > stretch.least[1]):
            stretch.least = least
        if self._line is None:
            self._fit()

    def _forget_what_contradicts(self, most: tuple[int, int] | None, least: tuple[int, int] | None) -> None:
        """A message before its own sending: the line is wrong now. One of the clocks was set, or is being slewed."""
        if self._line is None:
            return
        too_low_ns = 0.0 if least is None else least[1] - self._line.at(least[0])
        too_high_ns = 0.0 if most is None else self._line.at(most[0]) - most[1]
        outside_ns = max(too_low_ns, too_high_ns)
        if outside_ns > STEP_NS:
            self._stretches.clear()
            self._line = None
        elif outside_ns > LEAST_SIGMA_NS:
            for _ in range(len(self._stretches) // 2):
                self._stretches.popleft()

    def _fit(self) -> None:
        """Weighted least squares through the middles of the corridors, with what crystals are like as prior."""
        slope = (
            0.0 if self._line is None else self._line.slope
        )  # of the last fit: the next one is a tenth of a second off
        middles = [middle for stretch in self._stretches if (middle := stretch.middle(slope)) is not None]
        if not middles:
            quickest = [stretch.most for stretch in self._stretches if stretch.most is not None]
            if quickest:
                self._line = _Line(*min(quickest, key=lambda most: most[1]))
            return
        t, difference, width = np.array(middles).T
        # A queue lasts: what it adds is the same in many stretches, which do not average it out.
        sigma = LEAST_SIGMA_NS + (width - width.min()) / 2 * math.sqrt(len(middles))
        weight = sigma**-2
        t_mean, mean = np.average(np.stack((t, difference)), axis=1, weights=weight)
        information = float(np.sum(weight * (t - t_mean) ** 2)) + DRIFT_SIGMA**-2
        slope = float(np.sum(weight * (t - t_mean) * (difference - mean))) / information
        slope = min(max(slope, -MAX_CRYSTAL_DRIFT), MAX_CRYSTAL_DRIFT)
        slope_sigma = information**-0.5
        bound = width / 2 + np.abs(difference - mean - slope * (t - t_mean))
        best = int(np.argmin(bound + slope_sigma * (t[-1] - t)))
        self._line = _Line(float(t_mean), float(mean), slope, slope_sigma, float(bound[best]), float(t[best]))
