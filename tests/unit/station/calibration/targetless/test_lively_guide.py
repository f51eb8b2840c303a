"""What is asked of a person who carries the robot about."""

from __future__ import annotations

import numpy as np

from station.calibration.guidance import Guidance
from station.calibration.targetless.guide import LivelyGuide
from station.model.frames import ImuBatch

RATE_HZ = 100


def second(axis: int, rate_rad_s: float, begin_s: float) -> ImuBatch:
    """A second of turning to and fro about one axis of the body."""
    t_s = begin_s + np.arange(RATE_HZ + 1) / RATE_HZ
    gyro = np.zeros((len(t_s), 3))
    gyro[:, axis] = rate_rad_s * np.sign(np.sin(2 * np.pi * t_s + 0.1))
    return ImuBatch((t_s * 1e9).astype(np.int64), gyro, np.tile([0.0, 0.0, 9.81], (len(t_s), 1)))


def carried(seconds: int, axes: tuple[int, ...], rate_rad_s: float) -> Guidance:
    guide = LivelyGuide()
    for s in range(seconds - 1):
        guide.feel(second(axes[s % len(axes)], rate_rad_s, float(s)))
    return guide.feel(second(axes[-1], rate_rad_s, float(seconds)))


def test_a_robot_that_is_turned_about_all_axes_for_long_enough_is_enough() -> None:
    guidance = carried(60, (0, 1, 2), 1.0)
    assert guidance.is_enough and guidance.may_finish and guidance.instruction == "enough: finish"


def test_the_axis_about_which_it_was_turned_least_is_asked_for() -> None:
    assert carried(20, (1, 2), 1.0).instruction.startswith("roll the robot")
    assert carried(20, (0, 2), 1.0).instruction.startswith("tilt it")
    assert carried(20, (0, 1), 1.0).instruction.startswith("turn it left and right")


def test_a_robot_that_lies_still_gets_nowhere_whatever_the_gyroscopes_bias() -> None:
    guidance = carried(60, (0, 1, 2), 0.05)
    assert not guidance.may_finish and set(guidance.poses.values()) == {0.0}
