"""Wheels that follow their commands late, and the rest after the last one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.simulation.config import BodyParameters
from station.model.frames import DriveSample, ImuBatch
from station.motion.drive_commands import (
    COMMAND_HOLD_S,
    MOTOR_LAG_S,
    REST_AFTER_S,
    SPEED_EFFICIENCY,
    CommandedRest,
    WheelSpeed,
    resting_samples,
    wheel_motion,
)

SECOND = 1_000_000_000


def test_the_lag_is_as_late_in_the_mean_as_the_simulated_motors() -> None:
    # A critically damped response is two equal lags, one after the other.
    assert pytest.approx(2 * BodyParameters().lag_s) == MOTOR_LAG_S


def test_wheels_follow_a_new_speed_late_and_stop_as_late() -> None:
    wheels = WheelSpeed()
    wheels.add_drive(DriveSample(0, 0.4, 0.0))
    wheels.advance(round(MOTOR_LAG_S * SECOND))
    assert wheels.speed_m_s == pytest.approx(SPEED_EFFICIENCY * 0.4 * (1 - np.exp(-1)))
    assert wheels.missing_m_s == pytest.approx(SPEED_EFFICIENCY * 0.4 * np.exp(-1))
    for k in range(1, 20):
        wheels.add_drive(DriveSample(k * SECOND // 10, 0.4, 0.0))
    wheels.add_drive(DriveSample(2 * SECOND, 0.0, 0.0))
    assert wheels.way_m == pytest.approx(SPEED_EFFICIENCY * 0.4 * (2.0 - MOTOR_LAG_S), abs=1e-4)
    wheels.advance(5 * SECOND)
    assert wheels.way_m == pytest.approx(SPEED_EFFICIENCY * 0.4 * 2.0, abs=1e-4)
    assert abs(wheels.speed_m_s) < 1e-6


@given(cuts=st.lists(st.integers(0, 3 * SECOND), max_size=8))
def test_how_often_one_looks_changes_nothing(cuts: list[int]) -> None:
    once, often = WheelSpeed(), WheelSpeed()
    for wheels in (once, often):
        wheels.add_drive(DriveSample(0, 0.3, 0.0))
    for t in sorted(cuts):
        often.advance(t)
    for wheels in (once, often):
        wheels.advance(3 * SECOND)
    assert often.way_m == pytest.approx(once.way_m, abs=1e-12)
    assert often.speed_m_s == pytest.approx(once.speed_m_s, abs=1e-12)


def test_a_command_that_nothing_follows_ends_by_itself_unless_the_drive_is_recorded() -> None:
    wheels, only = WheelSpeed(), DriveSample(0, 0.3, 0.0)
    wheels.add_drive(only)
    wheels.advance(10 * SECOND)
    assert wheels.way_m == pytest.approx(SPEED_EFFICIENCY * 0.3 * COMMAND_HOLD_S, abs=1e-6)
    speed, way = wheel_motion([only], np.array([0, 10 * SECOND]))
    assert speed[1] == pytest.approx(0.3)
    assert way[1] == pytest.approx(0.3 * (10 - MOTOR_LAG_S), abs=1e-6)


def test_a_late_command_counts_from_now() -> None:
    wheels = WheelSpeed()
    wheels.add_drive(DriveSample(0, 0.0, 0.0))
    wheels.advance(SECOND)
    wheels.add_drive(DriveSample(SECOND - 50_000_000, 0.3, 0.0))
    assert wheels.way_m == 0.0
    wheels.advance(SECOND + SECOND // 10)
    assert 0.0 < wheels.way_m < 0.3 * 0.1


def test_a_body_rests_a_while_after_its_last_moving_command() -> None:
    t = np.arange(0, 6 * SECOND, SECOND // 100)
    imu = ImuBatch(t, np.zeros((len(t), 3)), np.zeros((len(t), 3)))
    drive = [DriveSample(SECOND + k * SECOND // 20, 0.3, 0.0) for k in range(40)]
    drive += [DriveSample(3 * SECOND + k * SECOND // 20, 0.0, 0.0) for k in range(40)]
    recorded = resting_samples(imu, drive)
    assert recorded[t < SECOND].all()
    assert not recorded[(t >= SECOND) & (t < 3 * SECOND + REST_AFTER_S * SECOND)].any()
    assert recorded[t >= 3 * SECOND + REST_AFTER_S * SECOND].all()
    live, coming = CommandedRest(), list(drive)
    for k, now in enumerate(t.tolist()):
        while coming and coming[0].t_robot_ns <= now:
            live.add_drive(coming.pop(0))
        if now > 0 and now != 3 * SECOND + round(REST_AFTER_S * SECOND):
            assert live.is_resting(now) == recorded[k], now


def test_without_commands_a_recorded_body_rests_and_with_a_last_one_to_move_it_never_does() -> None:
    t = np.arange(0, 3 * SECOND, SECOND // 10)
    imu = ImuBatch(t, np.zeros((len(t), 3)), np.zeros((len(t), 3)))
    assert resting_samples(imu, []).all()
    assert not resting_samples(imu, [DriveSample(0, 0.0, 0.5)]).any()
