"""Simulated servos are late and off, as their parameters tell, and stay exactly still until they are used."""

import math

import msgspec
import numpy as np

from robot.simulation.body import TICK_RATE_HZ, TICK_S, MotionState
from robot.simulation.config import ServoImperfections, without_imperfections
from robot.simulation.servos import Servos, error_of_angle
from robot.simulation.trajectory import MotionHistory
from shared.calibration import REFERENCE_HEAD
from shared.geometry import se3, yaw_rotation
from shared.head import turned

IDEAL = without_imperfections().servos


def settled(servos: Servos, pan: float, tilt: float = 0.0, seconds: float = 1.0) -> tuple[float, float]:
    servos.point(pan, tilt)
    return [servos.step() for _ in range(round(seconds * TICK_RATE_HZ))][-1]


def test_ideal_servos_are_where_they_are_told() -> None:
    servos = Servos(IDEAL, 0)
    servos.point(0.5, -0.2)
    assert servos.step() == (0.5, -0.2)


def test_servos_that_were_never_used_stay_exactly_still() -> None:
    assert settled(Servos(ServoImperfections(), 0), 0.0) == (0.0, 0.0)


def test_the_error_belongs_to_the_angle_and_has_its_size() -> None:
    angles = np.radians(np.linspace(-60, 60, 200))
    for seed in range(5):
        error = error_of_angle(math.radians(3.0), np.random.default_rng(seed))
        rms = math.degrees(math.sqrt(np.mean([error(float(a)) ** 2 for a in angles])))
        assert error(0.0) == 0.0 and abs(rms - 3.0) < 0.1
    servos = Servos(msgspec.structs.replace(IDEAL, error_deg=3.0), 1)
    first = settled(servos, 0.6)
    settled(servos, -0.4)
    assert settled(servos, 0.6) == first and abs(first[0] - 0.6) > math.radians(0.1)


def test_backlash_is_the_difference_of_both_sides() -> None:
    servos = Servos(msgspec.structs.replace(IDEAL, backlash_deg=1.0), 0)
    from_left, from_right = (settled(servos, start) and settled(servos, 0.3) for start in (0.8, -0.8))
    assert math.isclose(math.degrees(from_left[0] - from_right[0]), 1.0, rel_tol=1e-9)


def test_delay_and_lag_are_as_told() -> None:
    servos = Servos(msgspec.structs.replace(IDEAL, delay_s=0.04, lag_s=0.1), 0)
    servos.point(1.0, 0.0)
    pans = [servos.step()[0] for _ in range(90)]
    assert pans[8] == 0.0 < pans[9]
    risen_s = TICK_S * next(i + 1 for i, pan in enumerate(pans) if pan > 1 - math.exp(-1))
    assert abs(risen_s - 0.14) < 2 * TICK_S


def test_the_head_carries_the_camera_between_two_ticks() -> None:
    zero = np.zeros(3)
    R, p = yaw_rotation(0.3), np.array([1.0, 2.0, 0.2])
    states = [MotionState(0.0, p, R, zero, zero, zero), MotionState(TICK_S, p, R, zero, zero, zero, head=(0.2, -0.1))]
    T = MotionHistory(states).head_pose(TICK_S / 2, REFERENCE_HEAD)
    np.testing.assert_allclose(T, se3(R, p) @ turned(REFERENCE_HEAD, 0.1, -0.05), atol=1e-12)
    assert (MotionHistory(states).head_pose(TICK_S, None) == se3(R, p)).all()


def test_one_robot_has_the_same_servos_in_every_drive() -> None:
    wrong = msgspec.structs.replace(IDEAL, error_deg=3.0)
    own = msgspec.structs.replace(wrong, seed=5)
    angle = math.radians(40)
    assert settled(Servos(own, 1), angle) == settled(Servos(own, 2), angle) == settled(Servos(wrong, 5), angle)
    assert settled(Servos(wrong, 1), angle) != settled(Servos(wrong, 2), angle)
