"""The clock estimate finds what was injected."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.clock import WINDOW_NS, RemoteClock
from tests.support.clock import MS, S, feed

EPOCHS = st.integers(-(10**18), 2 * 10**18)


@settings(max_examples=25, deadline=None)
@given(
    drift_ppm=st.floats(-5000, 5000),
    offset_ns=EPOCHS,
    kind=st.sampled_from(["exponential", "uniform", "spiky"]),
    seed=st.integers(0, 10**6),
)
def test_drift_and_offset_are_found_within_30_s_of_jittered_arrivals(
    drift_ppm: float, offset_ns: int, kind: str, seed: int
) -> None:
    clock = RemoteClock()
    last_remote_ns = feed(clock, drift_ppm, offset_ns, kind, seed)
    assert clock.fit is not None
    assert abs(clock.fit.drift_ppm - drift_ppm) <= 20
    for second in range(31):
        local_ns = second * S
        remote_ns = local_ns + round(local_ns * drift_ppm * 1e-6) - offset_ns
        assert abs(clock.fit.to_local_ns(remote_ns) - local_ns) <= 300_000
    assert clock.steps == 0
    assert last_remote_ns >= clock.fit.reference_remote_ns


@given(drift_ppm=st.floats(-5000, 5000), offset_ns=EPOCHS, t_remote_ns=st.integers(0, 60 * S))
@settings(max_examples=20, deadline=None)
def test_local_and_remote_times_are_inverse(drift_ppm: float, offset_ns: int, t_remote_ns: int) -> None:
    clock = RemoteClock()
    feed(clock, drift_ppm, offset_ns, "exponential", 0, seconds=5)
    assert clock.fit is not None
    t_remote_ns -= offset_ns
    assert abs(clock.fit.to_remote_ns(clock.fit.to_local_ns(t_remote_ns)) - t_remote_ns) <= 2


def test_no_estimate_before_the_first_arrival() -> None:
    assert RemoteClock().fit is None


def test_first_arrival_gives_an_offset_at_once() -> None:
    clock = RemoteClock()
    clock.add(1000, 5000)
    assert clock.fit is not None and clock.fit.to_local_ns(1000) == 5000


@pytest.mark.parametrize("jump_s", [3.0, 3600.0])
def test_a_remote_clock_that_was_set_forward_is_followed_at_once(jump_s: float) -> None:
    clock = RemoteClock()
    last_remote_ns = feed(clock, 0.0, 0, "exponential", 1)
    jump_ns = int(jump_s * S)
    clock.add(last_remote_ns + jump_ns + 10 * MS, last_remote_ns + 10 * MS)
    assert clock.fit is not None
    assert clock.fit.offset_at_ns(last_remote_ns + jump_ns + 10 * MS) == -jump_ns
    assert clock.steps == 1


def test_a_remote_clock_that_restarted_is_followed() -> None:
    clock = RemoteClock()
    feed(clock, 0.0, -100 * S, "exponential", 2)  # the robot was up for 100 s
    clock.add(5 * S, 200 * S)
    assert clock.fit is not None and clock.fit.to_local_ns(5 * S) == 200 * S


def test_memory_stays_bounded_and_old_arrivals_are_forgotten() -> None:
    clock = RemoteClock()
    for k in range(20_000):
        clock.add(k * S // 100, k * S // 100 + (0 if k < 100 else 7 * MS))
    arrivals = clock._arrivals
    assert len(arrivals) <= WINDOW_NS // (40 * MS) + 1
    assert clock.fit is not None and clock.fit.offset_at_ns(200 * S) == 7 * MS
