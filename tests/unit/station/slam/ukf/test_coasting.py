"""Dead reckoning while nothing is tracked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import REFERENCE_ROBOT
from station.model.frames import DriveSample
from station.motion.drive_commands import MOTOR_LAG_S
from station.motion.preintegration import ImuSegment
from station.slam.ukf.backend import UkfBackend
from station.slam.ukf.start.coasting import Coasting
from station.slam.ukf.start.starter import Anchor

FRAME_NS = 50_000_000


def imu(turn_rate: float) -> ImuSegment:
    """A twentieth of a second."""
    n = 10
    gyro = np.tile([0.0, 0.0, turn_rate], (n, 1))
    return ImuSegment(np.full(n, 0.005), gyro, np.zeros((n, 3)), 0, gyro[-1], np.ones((n, 6)))


def coast(anchor: Anchor, turn_rate: float, speed: float | None, frames: int) -> Coasting:
    coasting = Coasting(anchor, 0)
    for k in range(1, frames + 1):
        coasting.advance(imu(turn_rate), k * FRAME_NS, None if speed is None else speed * FRAME_NS * 1e-9)
    return coasting


@given(speed=st.floats(0.0, 0.6), turn_rate=st.floats(-2.0, 2.0), yaw=st.floats(-3.0, 3.0), bias=st.floats(-0.05, 0.05))
def test_an_arc_ends_where_geometry_says(speed: float, turn_rate: float, yaw: float, bias: float) -> None:
    start = Anchor(np.array([1.0, -2.0, 0.25]), yaw, np.array([0.0, 0.0, bias, 0.0, 0.0, 0.0]))
    end = coast(start, turn_rate + bias, speed, 40).at(40 * FRAME_NS)
    turned = turn_rate * 2.0
    # The chord of an arc of 2 s: half the turn off the first heading.
    chord = speed * 2.0 * np.sinc(turned / 2 / np.pi)
    expected = start.x_world + chord * np.array([np.cos(yaw + turned / 2), np.sin(yaw + turned / 2), 0.0])
    np.testing.assert_allclose(end.x_world, expected, atol=2e-3)
    assert end.yaw_rad == pytest.approx(yaw + turned)


def test_a_start_in_motion_is_told_where_its_window_began() -> None:
    coasting = coast(Anchor(np.zeros(3), 0.0, None), 0.0, 0.4, 60)
    assert coasting.at(20 * FRAME_NS).x_world[0] == pytest.approx(0.4)
    assert coasting.at(-FRAME_NS).x_world[0] == 0.0


def test_without_wheels_or_in_somebodys_hands_the_place_stays() -> None:
    end = coast(Anchor(np.ones(3), 0.3, None), 1.0, None, 20).at(20 * FRAME_NS)
    assert end.yaw_rad == 0.3 and (end.x_world == 1.0).all()


def test_a_command_holds_until_the_next_however_long_that_takes() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    backend.add_drive(DriveSample(0, 0.3, 0.0))  # a recording has no other while it stays the same
    rolled = [backend._rolled_m(k * FRAME_NS) or 0.0 for k in range(1, 41)]
    assert sum(rolled) == pytest.approx(0.3 * (2.0 - MOTOR_LAG_S), rel=1e-3)


def test_wheels_of_a_robot_that_was_lifted_count_again_once_it_is_tracked() -> None:
    backend = UkfBackend(REFERENCE_ROBOT)
    backend._is_lifted = True  # when tracking was lost, and so it stays until that happens again
    backend.add_drive(DriveSample(0, 0.3, 0.0))
    assert [backend._rolled_m(k * FRAME_NS) for k in range(1, 21)] == [None] * 20
    followed: Any = object()
    backend._filter = followed
    assert backend._rolled_m(21 * FRAME_NS) == pytest.approx(0.3 * FRAME_NS * 1e-9, rel=1e-2)
