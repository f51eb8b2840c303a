"""What is said while an inertial unit is left alone."""

from __future__ import annotations

import numpy as np

from station.calibration.guidance import Guidance
from station.calibration.imu.guide import StillGuide
from station.model.frames import ImuBatch

RATE_HZ = 200


def feel(guide: StillGuide, seconds: int, rng: np.random.Generator, noise: float = 0.003) -> Guidance:
    """So many seconds of a unit whose readings scatter so much."""
    assert seconds > 0
    for _ in range(seconds):
        t_ns = np.arange(RATE_HZ + 1) * (1_000_000_000 // RATE_HZ)
        gyro = rng.normal(0.0, noise, (len(t_ns), 3))
        accel = rng.normal((0.0, 0.0, 9.81), 10 * noise, (len(t_ns), 3))
        said = guide.feel(ImuBatch(t_ns, gyro, accel))
    return said


def test_a_minute_at_rest_may_be_finished_and_half_an_hour_is_enough() -> None:
    guide, rng = StillGuide(), np.random.default_rng(1)
    assert not feel(guide, 61, rng).may_finish  # the estimate may see two seconds less
    said = feel(guide, 1, rng)
    assert said.may_finish and not said.is_enough
    said = feel(guide, 1740, rng)
    assert said.is_enough and said.poses["time"] == 1.0


def test_who_moves_it_is_told_so_and_the_minute_begins_anew() -> None:
    guide, rng = StillGuide(), np.random.default_rng(2)
    feel(guide, 40, rng)
    assert "moved" in feel(guide, 1, rng, noise=0.02).instruction
    assert not feel(guide, 40, rng).may_finish
    assert feel(guide, 25, rng).may_finish


def test_a_unit_in_a_hand_never_lies_still() -> None:
    assert feel(StillGuide(), 90, np.random.default_rng(3), noise=0.2).poses["time"] == 0.0
