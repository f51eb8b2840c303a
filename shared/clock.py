"""What another machine's clock shows at a given time here: offset and drift from one-way arrivals, without its help.

An arrival is late by the clocks' difference plus a delay that is never negative. So the true line `local - remote` over
`remote` lies below all arrivals and is touched by the quickest ones. Of all lines below them we take the one with the
least summed distance: the edge of the lower convex hull above the mean time. It needs no model of the delays, and late
outliers cannot pull it. What stays in it is the least delay itself, which no one-way method can see.
Source: Moon, Skelly, Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

WINDOW_NS = 60_000_000_000  # a crystal's drift follows its temperature: older arrivals would bend the line
BIN_NS = 200_000_000  # of each fifth of a second only the quickest arrival is kept: 300 points at most
REFIT_NS = 500_000_000  # a fit costs a fifth of a millisecond on a PC, and a station has a clock for each robot
MIN_SPAN_NS = 2_000_000_000  # a shorter stretch says nothing on drift
MAX_DRIFT = 0.02  # resonators are off by 0.5 %; more is not a clock
MAX_CRYSTAL_DRIFT = 600e-6  # of two computers: 50 ppm each, and what NTP may slew them by (500 ppm)
STEP_NS = 1_000_000_000  # an arrival that much too early: the remote clock was set, or ours slept


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Line through the quickest arrivals: `local - remote = offset + slope * (remote - reference)`."""

    reference_remote_ns: int
    offset_ns: int  # at the reference; holds the least delay
    slope: float

    @property
    def drift_ppm(self) -> float:
        """How much faster the remote clock runs than ours, parts per million."""
        return (1.0 / (1.0 + self.slope) - 1.0) * 1e6

    def offset_at_ns(self, t_remote_ns: int) -> int:
        """local - remote at a remote time."""
        return self.offset_ns + round(self.slope * (t_remote_ns - self.reference_remote_ns))

    def to_local_ns(self, t_remote_ns: int) -> int:
        """Our time when the remote clock shows `t_remote_ns`."""
        return t_remote_ns + self.offset_at_ns(t_remote_ns)

    def to_remote_ns(self, t_local_ns: int) -> int:
        """What the remote clock shows at our time."""
        since_reference = t_local_ns - self.reference_remote_ns - self.offset_ns
        return self.reference_remote_ns + round(since_reference / (1.0 + self.slope))


class RemoteClock:
    """Collects arrivals of one remote clock and keeps the line through the quickest ones. Memory is bounded."""

    def __init__(self, max_drift: float = MAX_DRIFT) -> None:
        """`max_drift`: what exceeds it is no clock's drift, but a queue on the way that fills or empties."""
        self._max_drift = max_drift
        self._arrivals: deque[tuple[int, int]] = deque()  # (t_remote_ns, local - remote), one per bin
        self.fit: ClockFit | None = None  # the present line; None before the first arrival
        self._fitted_at_ns = 0
        self.steps = 0  # how often one of the clocks jumped and the estimate began anew

    def add(self, t_remote_ns: int, t_local_ns: int) -> None:
        """Something stamped `t_remote_ns` by the remote clock arrived at our time `t_local_ns`."""
        difference = t_local_ns - t_remote_ns
        if self._has_stepped(t_remote_ns, difference):
            self._arrivals.clear()
            self.fit = None
            self.steps += 1
        self._store(t_remote_ns, difference)
        while t_remote_ns - self._arrivals[0][0] > WINDOW_NS:
            self._arrivals.popleft()
        if self.fit is None or t_remote_ns - self._fitted_at_ns >= REFIT_NS:
            self.fit = fit_lower_line(list(self._arrivals), self._max_drift)
            self._fitted_at_ns = t_remote_ns
        elif difference < self.fit.offset_at_ns(t_remote_ns):
            # Quicker than all before: lower the line at once, its slope follows at the next fit.
            self.fit = ClockFit(t_remote_ns, difference, self.fit.slope)

    def _has_stepped(self, t_remote_ns: int, difference: int) -> bool:
        if not self._arrivals or self.fit is None:
            return False
        last_remote_ns = self._arrivals[-1][0]
        if t_remote_ns < last_remote_ns - WINDOW_NS:
            return True
        allowed = STEP_NS + self._max_drift * abs(t_remote_ns - last_remote_ns)
        return difference < self.fit.offset_at_ns(t_remote_ns) - allowed

    def _store(self, t_remote_ns: int, difference: int) -> None:
        if self._arrivals and t_remote_ns // BIN_NS <= self._arrivals[-1][0] // BIN_NS:
            last_remote_ns, last_difference = self._arrivals[-1]
            slope = self.fit.slope if self.fit else 0.0
            if difference - last_difference < slope * (t_remote_ns - last_remote_ns) and t_remote_ns >= last_remote_ns:
                self._arrivals[-1] = (t_remote_ns, difference)
        else:
            self._arrivals.append((t_remote_ns, difference))


def fit_lower_line(arrivals: list[tuple[int, int]], max_drift: float) -> ClockFit:
    """The line below all arrivals with the least summed distance to them.

    Args:
        arrivals: (t_remote_ns, local - remote in ns), at least one, the times increasing.
    """
    reference_ns, base_ns = arrivals[-1][0], arrivals[-1][1]
    if reference_ns - arrivals[0][0] < MIN_SPAN_NS:
        return ClockFit(reference_ns, min(difference for _, difference in arrivals), 0.0)
    # Small numbers first: products of nanosecond stamps would leave double precision (Python's ints do not).
    points = [(remote - reference_ns, difference - base_ns) for remote, difference in arrivals]
    left, right = _edge_at(points, sum(x for x, _ in points) / len(points))
    slope = (right[1] - left[1]) / (right[0] - left[0])
    if abs(slope) > max_drift:
        return ClockFit(reference_ns, min(difference for _, difference in arrivals), 0.0)
    return ClockFit(reference_ns, base_ns + round(left[1] - slope * left[0]), slope)


def _edge_at(points: list[tuple[int, int]], x: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """The edge of the lower convex hull that spans x. Source: Andrew's monotone chain, 1979."""
    hull: list[tuple[int, int]] = []
    for point in points:
        while len(hull) >= 2 and _turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    for left, right in pairwise(hull):
        if right[0] >= x:
            return left, right
    return hull[-2], hull[-1]


def _turn(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> int:
    """Positive where the way a, b, c turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
