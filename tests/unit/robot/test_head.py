"""The head is led evenly to where it shall look."""

import math

import pytest

from robot.head import CameraHead
from shared.calibration import REFERENCE_HEAD
from shared.errors import DeviceLost

SECOND = 1_000_000_000


class Servos:
    def __init__(self) -> None:
        self.told: list[tuple[float, float]] = []

    def point(self, pan_rad: float, tilt_rad: float) -> None:
        self.told.append((pan_rad, tilt_rad))


def test_the_head_turns_evenly_and_arrives() -> None:
    servos = Servos()
    head = CameraHead(servos.point, REFERENCE_HEAD)
    head.look(0.7, -0.07, 5 * SECOND)
    assert servos.told == [(0.0, 0.0)] and head.turns(5 * SECOND)
    head.lead(5 * SECOND + SECOND // 10)
    assert servos.told[-1] == pytest.approx((0.07, -0.07))
    assert head.told(5 * SECOND + SECOND // 2) == pytest.approx((0.35, -0.07))
    head.lead(6 * SECOND + 1)
    assert servos.told[-1] == (0.7, -0.07) and not head.turns(6 * SECOND + 1)


def test_a_head_whose_whole_way_went_by_unled_still_lags() -> None:
    """Where the computer stood still for as long as it took."""
    servos = Servos()
    head = CameraHead(servos.point, REFERENCE_HEAD)
    head.look(0.3, -0.1, 0)
    assert not head.turns(9 * SECOND) and head.lags(9 * SECOND)
    head.lead(9 * SECOND)
    assert servos.told[-1] == (0.3, -0.1) and not head.lags(9 * SECOND)


def test_servos_that_did_not_obey_are_told_again() -> None:
    servos = Servos()
    is_broken = [False]

    def point(pan_rad: float, tilt_rad: float) -> None:
        if is_broken[0]:
            raise DeviceLost("no answer")
        servos.point(pan_rad, tilt_rad)

    head = CameraHead(point, REFERENCE_HEAD)
    head.look(0.3, 0.0, 0)
    is_broken[0] = True
    with pytest.raises(DeviceLost):
        head.lead(SECOND)
    is_broken[0] = False
    assert head.lags(SECOND)


def test_another_wish_on_the_way_goes_on_from_there() -> None:
    head = CameraHead(Servos().point, REFERENCE_HEAD)
    head.look(0.7, 0.0, 0)
    head.look(-0.7, 0.0, SECOND // 2)
    assert head.told(SECOND // 2) == pytest.approx((0.35, 0.0))
    assert head.told(SECOND) == pytest.approx((0.0, 0.0))


def test_no_further_than_the_head_can() -> None:
    head = CameraHead(Servos().point, REFERENCE_HEAD)
    head.look(math.pi, -math.pi, 0)
    assert head.told(100 * SECOND) == (REFERENCE_HEAD.max_pan, -REFERENCE_HEAD.max_tilt)


def test_a_head_of_which_nothing_is_known_goes_there_at_once() -> None:
    servos = Servos()
    head = CameraHead(servos.point, None)
    head.look(1.0, 0.5, 0)
    assert servos.told == [(1.0, 0.5)] and not head.turns(0)
