"""The Mega's clock seen from the Pi: drift, jittered delivery, wraps."""

import random
from itertools import pairwise

import pytest

from robot.devices.pi.mega_clock import MegaClock

LEAST_DELAY_NS = 1_800_000


def arrivals(drift_ppm: float, seconds: float, seed: int, start_us: int = 0) -> list[tuple[int, int, int]]:
    """(t_us as the Mega sends it, true time ns, arrival ns) at 225 Hz. USB polls once per ms; a busy Pi adds bursts."""
    rng = random.Random(seed)
    out, last_ns = [], 0
    for i in range(int(seconds * 225)):
        t_ns = 5_000_000_000 + round(i * 1e9 / 225)
        t_us = (start_us + int(t_ns * (1 + drift_ppm * 1e-6)) // 1000) % 2**32
        delay_ns = LEAST_DELAY_NS + rng.expovariate(1 / 0.8e6) + (20e6 * rng.random() if rng.random() < 0.05 else 0)
        last_ns = max(last_ns, t_ns + round(delay_ns))
        out.append((t_us, t_ns, last_ns))
    return out


@pytest.mark.parametrize("drift_ppm", [-5000.0, -37.0, 0.0, 5000.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_drift_and_times_are_right_after_thirty_seconds(drift_ppm: float, seed: int) -> None:
    clock = MegaClock(LEAST_DELAY_NS)
    errors_ns = []
    for i, (t_us, t_true_ns, t_arrival_ns) in enumerate(arrivals(drift_ppm, 40, seed)):
        error_ns = clock.stamp(t_us, t_arrival_ns) - t_true_ns
        if i == 30 * 225:
            assert clock.drift_ppm == pytest.approx(drift_ppm, abs=20)
        if i >= 30 * 225:
            errors_ns.append(abs(error_ns))
    assert max(errors_ns) <= 300_000


def test_stamps_go_on_through_the_wrap() -> None:
    clock = MegaClock(LEAST_DELAY_NS)
    stamps = [clock.stamp(t_us, t_ns) for t_us, _, t_ns in arrivals(100, 10, 4, start_us=2**32 - 10_000_000)]
    steps = [b - a for a, b in pairwise(stamps[1000:])]
    assert min(steps) > 0 and max(steps) < 5_500_000


def test_stamps_never_run_backwards() -> None:
    clock = MegaClock(LEAST_DELAY_NS)
    stamps = [clock.stamp(t_us, t_ns) for t_us, _, t_ns in arrivals(-5000, 8, 5)]
    assert all(b > a for a, b in pairwise(stamps))
