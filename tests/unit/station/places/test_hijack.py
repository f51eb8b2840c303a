"""Hijack detection: what people do to a robot, and what floors, motors and lenses do."""

from __future__ import annotations

import numpy as np
import pytest

from shared.calibration import REFERENCE_HEAD
from shared.geometry import yaw_rotation
from shared.head import turned
from station.model.frames import DriveSample, ImuBatch
from station.model.place_answer import HijackEvent
from station.motion.dead_reckoning import DeadReckoning
from station.motion.head import AHEAD, Aim
from station.places.tracking.hijack import HijackDetector
from station.vision.features import Features, to_bytes
from tests.support.motion import SECOND, imu, lift, seconds


def feed(detector: HijackDetector, batches: list[ImuBatch]) -> list[HijackEvent]:
    return [event for batch in batches if (event := detector.on_imu(batch)) is not None]


def test_being_lifted_is_noticed_once_and_ends_when_put_down() -> None:
    detector = HijackDetector()
    assert not feed(detector, imu(seconds(3), seconds(3)))
    events = feed(detector, imu(seconds(0.8), lift(), 3.0, 1))
    assert len(events) == 1
    assert events[0].cue == "imu" and "lifted" in events[0].reason
    assert detector.is_carried
    assert not feed(detector, imu(seconds(2), seconds(2), 3.8, 2))
    assert not detector.is_carried


def test_being_tilted_is_noticed() -> None:
    detector = HijackDetector()
    feed(detector, imu(seconds(3), seconds(3)))
    roll = seconds(0.5)
    roll[:, 0] = 0.6
    events = feed(detector, imu(roll, seconds(0.5), 3.0))
    assert len(events) == 1 and "tilted" in events[0].reason


def test_turning_counts_only_while_the_motors_rest() -> None:
    turning = seconds(2)
    turning[:, 2] = 0.8
    resting, driving = HijackDetector(), HijackDetector()
    feed(resting, imu(seconds(3), seconds(3)))
    feed(driving, imu(seconds(3), seconds(3)))
    assert any("turned" in e.reason for e in feed(resting, imu(turning, seconds(2), 3.0)))
    for k, batch in enumerate(imu(turning, seconds(2), 3.0)):
        if k % 2 == 0:
            driving.on_drive(DriveSample(int(batch.t_robot_ns[0]), 0.0, 2.0))
        assert driving.on_imu(batch) is None


def test_a_collision_and_hard_braking_are_no_hijack() -> None:
    jolt = seconds(4)
    jolt[200, 0] = -60.0
    jolt[300:340, 0] = -3.0
    assert not feed(HijackDetector(), imu(seconds(4), jolt))


def features(rng: np.random.Generator, n: int = 400) -> Features:
    return Features(rng.uniform(0, 480, (n, 2)), to_bytes((rng.random((n, 128)) ** 6).astype(np.float32)))


def resting(detector: HijackDetector) -> None:
    """A gyroscope that says nothing turned: without one, views say nothing."""
    for batch in imu(seconds(0.2), seconds(0.2)):
        assert detector.on_imu(batch) is None


def test_without_wheels_hands_may_do_what_they_do_and_only_a_view_that_is_gone_is_a_hijack() -> None:
    rng = np.random.default_rng(3)
    detector, a, b = HijackDetector(has_wheels=False), features(rng), features(rng)
    accel = np.concatenate([seconds(2.0), lift(), -lift(), seconds(1.0)])
    gyro = np.zeros_like(accel)
    gyro[len(seconds(2.0)) :] = [0.5, -0.4, 0.8]
    assert not feed(detector, imu(gyro, accel)) and not detector.is_carried
    events = [detector.on_view(4 * SECOND + k * SECOND // 2, view) for k, view in enumerate([a, a, b, b])]
    assert events[:3] == [None, None, None] and events[3] is not None and events[3].cue == "vision"


def test_a_view_that_went_while_it_turned_any_way_is_no_hijack() -> None:
    rng = np.random.default_rng(4)
    a, b = features(rng), features(rng)
    for axis in np.eye(3):
        detector = HijackDetector(has_wheels=False)
        resting(detector)
        assert detector.on_view(SECOND // 5, a) is None
        gyro = seconds(0.5) + 0.6 * axis
        assert not feed(detector, imu(gyro, seconds(0.5)))
        assert detector.on_view(SECOND // 2, b) is None and detector.on_view(6 * SECOND // 10, b) is None


def test_a_view_that_changes_at_once_and_stays_is_a_hijack() -> None:
    rng = np.random.default_rng(0)
    detector, a, b = HijackDetector(), features(rng), features(rng)
    resting(detector)
    views = [a, a, b, b]
    events = [detector.on_view(k * SECOND // 2, view) for k, view in enumerate(views)]
    assert events[:3] == [None, None, None]
    assert events[3] is not None and events[3].cue == "vision"


def test_a_view_that_went_because_the_head_turned_is_no_hijack() -> None:
    rng = np.random.default_rng(0)
    detector, a, b = HijackDetector(), features(rng), features(rng)
    resting(detector)
    aside = Aim(turned(REFERENCE_HEAD, 0.8, 0.0), 0.05)
    views = [(a, AHEAD), (a, AHEAD), (b, aside), (b, aside)]
    assert not any(detector.on_view(k * SECOND // 2, view, aim) for k, (view, aim) in enumerate(views))


def test_a_covered_lens_and_a_passing_person_are_no_hijack() -> None:
    rng = np.random.default_rng(1)
    detector, room, dark = HijackDetector(), features(rng), features(rng, 3)
    person = features(rng)
    resting(detector)
    views = [room, dark, dark, room, person, room, room]
    assert all(detector.on_view(k * SECOND // 3, view) is None for k, view in enumerate(views))


def test_a_jump_of_the_estimate_is_one_event() -> None:
    detector = HijackDetector()
    event = detector.on_jump(SECOND, 4.93, is_other_map=False, moved=0.9)
    assert event is not None and event.cue == "position" and "4.9 m" in event.reason
    assert detector.on_jump(2 * SECOND, 3.0, is_other_map=False, moved=0.9) is None
    assert detector.on_jump(9 * SECOND, 3.0, is_other_map=False, moved=0.1) is None  # the estimate had been false
    other = detector.on_jump(9 * SECOND, 0.0, is_other_map=True, moved=0.9)
    assert other is not None and "another map" in other.reason


def test_a_robot_that_is_lifted_right_after_a_jump_of_the_estimate_is_hijacked_again() -> None:
    detector = HijackDetector()
    feed(detector, imu(seconds(3), seconds(3)))
    assert detector.on_jump(3 * SECOND, 3.3, is_other_map=False, moved=0.9) is not None
    [event] = feed(detector, imu(seconds(0.8), lift(), 3.0, 1))
    assert event.cue == "imu"
    assert detector.on_jump(event.t_robot_ns + SECOND, 4.0, is_other_map=False, moved=0.9) is None  # what it led to


def test_dead_reckoning_follows_gyro_and_commands() -> None:
    reckoning = DeadReckoning()
    for batch in imu(seconds(2), seconds(2)):
        reckoning.add_imu(batch)
    turning = seconds(4)
    turning[:, 2] = np.pi / 8
    for batch in imu(turning, seconds(4), 2.0):
        reckoning.add_drive(DriveSample(int(batch.t_robot_ns[0]), 0.2, 1.0))
        reckoning.add_imu(batch)
    # A quarter circle of length 0.8 m.
    radius = 0.2 / (np.pi / 8)
    T = reckoning.T_nav_body
    assert np.allclose(T[:3, :3], yaw_rotation(np.pi / 2), atol=0.05)
    assert np.allclose(T[:2, 3], [radius, radius], atol=0.06)


@pytest.mark.parametrize("bias", [0.0, 0.02, -0.03])
def test_dead_reckoning_does_not_turn_at_rest(bias: float) -> None:
    reckoning = DeadReckoning()
    for batch in imu(seconds(20) + bias, seconds(20)):
        reckoning.add_imu(batch)
    assert np.allclose(reckoning.T_nav_body, np.eye(4), atol=0.03)


def test_a_poor_view_that_is_gone_after_a_hand_s_breadth_is_no_hijack() -> None:
    rng = np.random.default_rng(2)
    detector, door_frame, room = HijackDetector(), features(rng, 230), features(rng)
    resting(detector)
    assert not any(detector.on_view(k * SECOND // 2, view) for k, view in enumerate([door_frame, room, room, room]))


@pytest.mark.parametrize("begun_s", [0.0, 0.3, 0.6, 0.9, 5.0])
def test_a_robot_put_down_is_carried_no_more_even_where_hands_came_before_gravity_was_learnt(begun_s: float) -> None:
    detector = HijackDetector()
    accel = np.concatenate([seconds(begun_s), lift(), -lift(), seconds(2.0)])
    assert feed(detector, imu(np.zeros_like(accel), accel))
    assert not detector.is_carried


def test_a_robot_in_moving_hands_stays_carried() -> None:
    detector = HijackDetector()
    accel = np.concatenate([seconds(5.0), lift(), *[sign * lift() for sign in (1, -1) * 4]])
    assert feed(detector, imu(np.zeros_like(accel), accel))
    assert detector.is_carried


def test_a_robot_that_drives_on_as_soon_as_it_is_put_down_is_carried_no_more() -> None:
    detector = HijackDetector()
    accel = np.concatenate([seconds(5.0), lift(), -lift(), seconds(2.0)])
    gyro = np.zeros_like(accel)
    gyro[-len(seconds(2.0)) :, 2] = np.linspace(0.0, 0.8, len(seconds(2.0)))  # into a turn
    assert feed(detector, imu(gyro, accel))
    assert not detector.is_carried
