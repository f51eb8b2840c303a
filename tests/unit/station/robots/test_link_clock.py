"""The robot's clock stays right while pictures fill the network: offset, drift, and the bound that is told."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from shared.clock import MAX_CRYSTAL_DRIFT
from shared.messages import HeartbeatReply
from station.robots.link_clock import LinkClock

MS, S = 1_000_000, 1_000_000_000
STARTED_NS = 900 * S  # of the robot's clock when the station's shows 0


@dataclass(frozen=True)
class Network:
    """Delays of one direction each, ms: the least, its spread, and what a queue of pictures adds at a time in s."""

    least_ms: float
    spread_ms: float
    queue_ms: Callable[[float], float]

    def up_ns(self, rng: np.random.Generator) -> int:
        return round((self.least_ms + rng.uniform(0.0, 2 * self.spread_ms)) * MS)

    def down_ns(self, t_s: float, rng: np.random.Generator) -> int:
        return self.up_ns(rng) + round(self.queue_ms(t_s) * MS)


def run(
    clock: LinkClock,
    network: Network,
    seconds: float,
    drift_ppm: float,
    seed: int,
    *,
    begin_s: float = 0.0,
    ahead_ns: int = 0,
) -> None:
    """Heartbeats ten times and drive reports twenty times a second, in the order of their arrival.

    Args:
        begin_s: of the station's clock.
        ahead_ns: so much farther the robot's clock is, since it was set.
    """
    rng = np.random.default_rng(seed)

    def robot_ns(t_ns: int) -> int:
        return STARTED_NS + t_ns + round(t_ns * drift_ppm * 1e-6) + ahead_ns

    arrivals: list[tuple[int, int, int]] = []  # (arrival, when said, the heartbeat answered or -1)
    for k in range(round(seconds * 20)):
        t_ns = round(begin_s * S) + k * S // 20
        heapq.heappush(arrivals, (t_ns + network.down_ns(t_ns / S, rng), t_ns, -1))
        if k % 2 == 0:
            heard_ns = t_ns + network.up_ns(rng)
            heapq.heappush(arrivals, (heard_ns + network.down_ns(heard_ns / S, rng), heard_ns, t_ns))
    while arrivals:
        now_ns, said_ns, beat_ns = heapq.heappop(arrivals)
        if beat_ns < 0:
            clock.add_stamp(robot_ns(said_ns), now_ns)
        else:
            at_ns = robot_ns(said_ns)
            clock.add_reply(_reply(beat_ns, at_ns), now_ns)


def _reply(beat_ns: int, at_ns: int) -> HeartbeatReply:
    return HeartbeatReply(seq=0, t_station_ns=beat_ns, t_robot_received_ns=at_ns, t_robot_sent_ns=at_ns)


def offset_error_ms(clock: LinkClock, now_ns: int, drift_ppm: float) -> float:
    offset_ns = clock.offset_ns(now_ns)
    assert offset_ns is not None
    return (offset_ns + STARTED_NS + now_ns * drift_ppm * 1e-6) / MS


def no_queue(_: float) -> float:
    return 0.0


def full_after_a_moment(t_s: float) -> float:
    """The first heartbeat goes out before the first picture."""
    return 0.0 if t_s < 0.3 else 185.0


def filling(t_s: float) -> float:
    """As a network does that gets slower and slower."""
    return min(200.0, 5.0 * t_s)


def saw(t_s: float) -> float:
    """A picture fifteen times a second, each 50 ms on its way."""
    return max(0.0, 50.0 - 1000.0 * (t_s % (1 / 15)))


NETWORKS = {
    "good": Network(3.0, 0.0, no_queue),
    "busy": Network(5.0, 10.0, saw),
    "two walls": Network(10.0, 30.0, saw),
    "bad": Network(100.0, 150.0, no_queue),
}
FULL = {
    "its queue is always full": Network(15.0, 0.0, full_after_a_moment),
    "its queue fills up": Network(15.0, 2.0, filling),
}


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("drift_ppm", [0.0, -40.0, 100.0])
@pytest.mark.parametrize("seed", range(3))
def test_offset_and_drift_are_right_on_bad_networks(name: str, drift_ppm: float, seed: int) -> None:
    clock = LinkClock()
    run(clock, NETWORKS[name], 120.0, drift_ppm, seed)
    error_ms = offset_error_ms(clock, 120 * S, drift_ppm)
    bound_ns = clock.bound_ns(120 * S)
    assert abs(error_ms) <= 2.0
    assert clock.drift_ppm is not None and abs(clock.drift_ppm - drift_ppm) <= 50.0
    assert bound_ns is not None and abs(error_ms) * MS <= bound_ns


@pytest.mark.parametrize("name", FULL)
@pytest.mark.parametrize("drift_ppm", [0.0, -40.0])
def test_a_queue_that_never_empties_moves_the_clock_by_no_more_than_its_drift(name: str, drift_ppm: float) -> None:
    """Nothing tells a queue's delay from a drift; the bound says so."""
    clock = LinkClock()
    run(clock, FULL[name], 120.0, drift_ppm, seed=0)
    error_ms = offset_error_ms(clock, 120 * S, drift_ppm)
    bound_ns = clock.bound_ns(120 * S)
    assert abs(error_ms) <= 2.0 + abs(drift_ppm) * 0.12  # over 120 s
    assert clock.drift_ppm is not None and abs(clock.drift_ppm - drift_ppm) <= 50.0
    assert bound_ns is not None and abs(error_ms) * MS <= bound_ns


def test_a_robot_time_becomes_the_stations_and_the_other_way_round() -> None:
    clock = LinkClock()
    run(clock, NETWORKS["good"], 60.0, 35.0, seed=0)
    for t_ns in (0, 30 * S, 60 * S):
        t_station_ns = clock.to_station_ns(STARTED_NS + t_ns + round(t_ns * 35e-6))
        assert t_station_ns == pytest.approx(t_ns, abs=MS)


def test_a_drift_that_no_crystal_has_is_refused() -> None:
    clock = LinkClock()
    run(clock, Network(15.0, 0.0, lambda t_s: 8.0 * t_s), 20.0, 0.0, seed=0)  # 8000 ppm, as a queue that fills has
    assert clock.drift_ppm is not None and abs(clock.drift_ppm) <= MAX_CRYSTAL_DRIFT * 1e6 < 8000


def test_before_anything_was_answered_nothing_is_said_of_the_uncertainty() -> None:
    clock = LinkClock()
    assert clock.offset_ns(0) is None and clock.to_station_ns(0) is None and clock.bound_ns(0) is None
    clock.add_stamp(STARTED_NS, 5 * MS)
    assert clock.offset_ns(5 * MS) == 5 * MS - STARTED_NS
    assert clock.bound_ns(5 * MS) is None


@pytest.mark.parametrize("jump_s", [-3600.0, -3.0, 3.0, 3600.0])
def test_a_clock_that_was_set_is_followed(jump_s: float) -> None:
    clock = LinkClock()
    run(clock, NETWORKS["good"], 30.0, 0.0, seed=0)
    for k in range(2):
        now_ns = (31 + k) * S
        clock.add_reply(_reply(now_ns - 6 * MS, STARTED_NS + now_ns - 3 * MS + round(jump_s * S)), now_ns)
    assert offset_error_ms(clock, 32 * S, 0.0) == pytest.approx(-jump_s * 1e3, abs=2.0)


@pytest.mark.parametrize("name", ["good", "busy", "two walls"])
@pytest.mark.parametrize("jump_ms", [-900, -20, 20, 900])
@pytest.mark.parametrize("seed", range(2))
def test_a_clock_that_jumped_by_less_than_a_second_is_known_again_within_seconds(
    name: str, jump_ms: int, seed: int
) -> None:
    clock = LinkClock()
    run(clock, NETWORKS[name], 60.0, 0.0, seed)
    run(clock, NETWORKS[name], 6.0, 0.0, seed, begin_s=60.0, ahead_ns=jump_ms * MS)
    assert offset_error_ms(clock, 66 * S, 0.0) == pytest.approx(-jump_ms, abs=2.0)
    bound_ns = clock.bound_ns(66 * S)
    assert bound_ns is not None and bound_ns <= 200 * MS


def test_a_jump_after_a_second_of_arrivals_is_known_at_the_next_one() -> None:
    clock = LinkClock()
    run(clock, NETWORKS["good"], 1.0, 0.0, seed=0)
    run(clock, NETWORKS["good"], 0.3, 0.0, seed=0, begin_s=1.0, ahead_ns=700 * MS)
    assert offset_error_ms(clock, 1300 * MS, 0.0) == pytest.approx(-700.0, abs=2.0)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("drift_ppm", [0.0, 40.0])
def test_what_is_told_of_the_uncertainty_holds_at_any_time(name: str, drift_ppm: float) -> None:
    clock = LinkClock()
    for second in range(60):
        run(clock, NETWORKS[name], 1.0, drift_ppm, second, begin_s=float(second))
        now_ns = (second + 1) * S
        bound_ns = clock.bound_ns(now_ns)
        assert bound_ns is not None and abs(offset_error_ms(clock, now_ns, drift_ppm)) * MS <= bound_ns
        assert clock.drift_ppm is not None and abs(clock.drift_ppm - drift_ppm) <= 50.0


def test_a_clock_that_is_slewed_is_followed() -> None:
    """NTP corrects a clock by up to 500 ppm for minutes."""
    clock = LinkClock()
    run(clock, NETWORKS["good"], 300.0, 0.0, seed=0)
    for k in range(6000):
        now_ns = 300 * S + k * S // 20
        slewed_ns = round((now_ns - 300 * S) * 500e-6)
        clock.add_reply(_reply(now_ns - 6 * MS, STARTED_NS + now_ns - 3 * MS + slewed_ns), now_ns)
    assert offset_error_ms(clock, 600 * S, 0.0) == pytest.approx(-150.0, abs=3.0)


def test_memory_stays_bounded() -> None:
    clock = LinkClock()
    run(clock, NETWORKS["good"], 1200.0, 0.0, seed=0)
    assert len(clock._stretches) <= 300
