"""A robot's clock as the station sees it: offset and drift from the quickest messages in both directions.

A message from the robot shows an offset that is too large by its delay, one to the robot an offset that is too small by
its delay. So the truth lies in a corridor between the least of the former and the greatest of the latter, whose middle
is right when the quickest messages of both directions took the same time.

The corridor's slope is the clocks' drift. Of each two seconds the quickest message counts, and by how much it took
longer than the quickest of all is exponential, with another mean each way: a direction that a queue makes late has
little weight. Sources: corridor: Duda, Harrus, Haddad, Bernard, "Estimating global time in distributed systems", ICDCS
1987; exponential delays: Jeske, "On maximum-likelihood estimation of clock offset", IEEE Trans. Communications 53(1),
2005; least delay of a window: Mills, RFC 5905, section 10 (clock filter).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from shared.clock import MAX_CRYSTAL_DRIFT
from shared.geometry import FloatArray
from shared.messages import HeartbeatReply

STRETCH_NS = 2_000_000_000  # long enough for some quick messages each way, short enough to see soon that a clock jumped
KEPT_STRETCHES = 300  # ten minutes
LEAST_SIGMA_NS = 200_000.0  # two event loops: nothing is known better
DRIFT_SIGMA = 25e-6  # of two crystals, each anywhere within 30 ppm, before anything is measured
SLEWED = 1e-4  # of the time NTP slews one of the clocks, by whatever: minutes in weeks
SLOPES = np.linspace(-MAX_CRYSTAL_DRIFT, MAX_CRYSTAL_DRIFT, 301)  # 4 ppm apart
_CRYSTALS = (1 - SLEWED) * np.exp(-0.5 * (SLOPES / DRIFT_SIGMA) ** 2) / (math.sqrt(math.tau) * DRIFT_SIGMA)
UNLIKELY = -np.log(_CRYSTALS + SLEWED / (2 * MAX_CRYSTAL_DRIFT))  # each slope, before anything is measured
REFIT_NS = 500_000_000  # a fit costs a millisecond
# So many stretches tell what is usual. Of n of them the quickest message is one n-th of the usual excess from the
# quickest there can be; one that is quicker by this many times the excess is another clock's.
USUAL_STRETCHES, UNUSUAL = 5, 1.5

Seen = tuple[int, int]  # (t_station, t_station - t_robot) of a message, both in ns


@dataclass(slots=True)
class _Stretch:
    """The corridor of two seconds."""

    begin_ns: int
    most: Seen | None = None  # of the quickest message from the robot
    least: Seen | None = None  # of the quickest one to it


@dataclass(frozen=True, slots=True)
class _Line:
    """`t_station - t_robot = difference + slope * (station - t)`, all in ns; `bound` holds at `t`."""

    t_ns: float
    difference_ns: float
    slope: float = 0.0
    slope_sigma: float = DRIFT_SIGMA
    half_width_ns: float = math.inf  # of the corridor
    bound_ns: float = math.inf

    def at(self, t_station_ns: float) -> float:
        return self.difference_ns + self.slope * (t_station_ns - self.t_ns)

    def distances(self, seen: FloatArray) -> FloatArray:
        """(n,) ns of differences above the line; `seen` are (n, 2) times and differences, ns."""
        return np.asarray(seen[:, 1] - self.difference_ns - self.slope * (seen[:, 0] - self.t_ns))

    def excludes(self, most: Seen | None, least: Seen | None) -> bool:
        """Whether a message came before its own sending, wherever in the corridor the truth is."""
        is_below = most is not None and most[1] < self.at(most[0]) - self.half_width_ns - LEAST_SIGMA_NS
        is_above = least is not None and least[1] > self.at(least[0]) + self.half_width_ns + LEAST_SIGMA_NS
        return is_below or is_above


class LinkClock:
    """Collects stamps of one run of robot-server. Memory is bounded; time is an argument."""

    def __init__(self) -> None:
        self._stretches: deque[_Stretch] = deque(maxlen=KEPT_STRETCHES)
        self._epoch_ns = 0  # differences are kept relative to the first: products of whole stamps would lose digits
        self._line: _Line | None = None
        self._fitted_ns = 0
        self.rtt_ns: int | None = None  # of the last heartbeat

    def add_reply(self, reply: HeartbeatReply, now_ns: int) -> None:
        inside_robot_ns = reply.t_robot_sent_ns - reply.t_robot_received_ns
        self.rtt_ns = now_ns - reply.t_station_ns - inside_robot_ns
        self.add_exchange(reply, now_ns)

    def add_exchange(self, reply: HeartbeatReply, now_ns: int) -> None:
        """An answer that did not come the way that commands go."""
        self._add(now_ns, least=(reply.t_station_ns, reply.t_station_ns - reply.t_robot_received_ns))
        self.add_stamp(reply.t_robot_sent_ns, now_ns)

    def add_stamp(self, t_robot_ns: int, now_ns: int) -> None:
        """Something the robot stamped when it sent it has arrived."""
        self._add(now_ns, most=(now_ns, now_ns - t_robot_ns))

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
        return round(line.bound_ns + line.slope_sigma * abs(now_ns - line.t_ns))

    @property
    def drift_ppm(self) -> float | None:
        """How much faster the robot's clock runs."""
        return None if self._line is None else -self._line.slope * 1e6

    def _add(self, now_ns: int, *, most: Seen | None = None, least: Seen | None = None) -> None:
        if not self._stretches:
            self._epoch_ns = (most or least or (0, 0))[1]
        most, least = self._near(most), self._near(least)
        self._store(now_ns, most, least)
        line = self._line
        is_excluded = line is not None and line.excludes(most, least)
        is_known = line is not None and not math.isinf(line.half_width_ns)
        if not is_known or is_excluded or now_ns - self._fitted_ns >= REFIT_NS:
            self._fit(now_ns)
        if is_excluded and self._line is not None and self._line.half_width_ns < 0.0:
            # No line is left that puts all arrivals behind their sending: a clock was set, is slewed, or slept.
            self._stretches.clear()
            self._store(now_ns, most, least)
            self._fit(now_ns)

    def _near(self, seen: Seen | None) -> Seen | None:
        return None if seen is None else (seen[0], seen[1] - self._epoch_ns)

    def _store(self, now_ns: int, most: Seen | None, least: Seen | None) -> None:
        if not self._stretches or now_ns - self._stretches[-1].begin_ns >= STRETCH_NS:
            self._stretches.append(_Stretch(now_ns))
        stretch = self._stretches[-1]
        if most is not None and (stretch.most is None or most[1] < stretch.most[1]):
            stretch.most = most
        if least is not None and (stretch.least is None or least[1] > stretch.least[1]):
            stretch.least = least

    def _fit(self, now_ns: int) -> None:
        self._fitted_ns = now_ns
        if self._has_jumped():
            newest = self._stretches[-1]
            self._stretches.clear()
            self._stretches.append(newest)
        most, least = _sides(self._stretches)
        if len(most) and len(least):
            self._line = fit_corridor(most, least)
        elif len(most):
            self._line = _Line(*most[most[:, 1].argmin()])

    def _has_jumped(self) -> bool:
        """Whether the newest stretch shows another difference of the clocks than those before it.

        A jump moves both sides of the corridor alike. A queue, or a way that got quicker, moves one of them.
        """
        line, newest = self._line, self._stretches[-1]
        if line is None or newest.most is None or newest.least is None:
            return False
        before = list(self._stretches)[:-2]  # in the one between it may have jumped
        above, below = (line.distances(side) for side in _sides(before))
        if min(len(above), len(below)) < USUAL_STRETCHES:
            return False
        usual_ns = UNUSUAL * (LEAST_SIGMA_NS + max(above.mean() - above.min(), below.max() - below.mean()))
        rise_ns = newest.least[1] - line.at(newest.least[0]) - below.max()
        fall_ns = above.min() - (newest.most[1] - line.at(newest.most[0]))
        return bool(-fall_ns > rise_ns > usual_ns or -rise_ns > fall_ns > usual_ns)


def _sides(stretches: Iterable[_Stretch]) -> tuple[FloatArray, FloatArray]:
    """Both sides of the corridor: (n, 2) times and differences of the quickest messages from and to the robot, ns."""
    most = [stretch.most for stretch in stretches if stretch.most is not None]
    least = [stretch.least for stretch in stretches if stretch.least is not None]
    return np.array(most, dtype=float).reshape(-1, 2), np.array(least, dtype=float).reshape(-1, 2)


def fit_corridor(most: FloatArray, least: FloatArray) -> _Line:
    """The line in the middle between both sides.

    Args:
        most, least: (n, 2) and (m, 2), n, m > 0: times and differences of what lies above and below the truth, ns.
    """
    t_ns = most[-1, 0]
    above = most[:, 1] - SLOPES[:, None] * (most[:, 0] - t_ns)  # (slopes, n)
    below = least[:, 1] - SLOPES[:, None] * (least[:, 0] - t_ns)
    late = above.mean(axis=1) - above.min(axis=1), below.max(axis=1) - below.mean(axis=1)
    # One less of each side: its least and its mean delay are both unknown, and all that they may be counts.
    misfit = (
        UNLIKELY
        + (len(most) - 1) * np.log(late[0] + LEAST_SIGMA_NS)
        + (len(least) - 1) * np.log(late[1] + LEAST_SIGMA_NS)
    )
    weight = np.exp(misfit.min() - misfit)
    slope = float(np.average(SLOPES, weights=weight))
    slope_sigma = float(np.average((SLOPES - slope) ** 2, weights=weight)) ** 0.5 + (SLOPES[1] - SLOPES[0]) / 2
    above, below = (side[:, 1] - slope * (side[:, 0] - t_ns) for side in (most, least))
    high, low = float(above.min()), float(below.max())
    middle = (high + low) / 2
    # Behind the sending of each message the truth is known to lie; from there it drifts.
    bound = max(
        float(np.min(side + slope_sigma * (t_ns - seen[:, 0])))
        for side, seen in ((above - middle, most), (middle - below, least))
    )
    return _Line(t_ns, middle, slope, slope_sigma, (high - low) / 2, bound)
