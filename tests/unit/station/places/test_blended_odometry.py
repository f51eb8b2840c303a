"""SLAM's late poses and dead reckoning make one path without tears."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray, inverse, se3, yaw_rotation
from station.places.tracking.odometry import BlendedOdometry

TICK_NS = 50_000_000


def circle(seconds: float, scale: float = 1.0, yaw_drift: float = 0.0) -> FloatArray:
    """Pose after driving along a circle of 1 m radius at 0.3 m/s, from the origin."""
    angle = 0.3 * seconds
    x = scale * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
    return se3(yaw_rotation(angle + yaw_drift * seconds), x)


def gap(a: FloatArray, b: FloatArray) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))


@given(late=st.integers(0, 80), world_yaw=st.floats(-3.0, 3.0), begins=st.integers(0, 40))
def test_slam_repairs_what_was_reckoned_wrong_however_late(late: int, world_yaw: float, begins: int) -> None:
    T_world_nav = se3(yaw_rotation(world_yaw), np.array([5.0, -3.0, 0.2]))
    odometry = BlendedOdometry()
    blended = np.eye(4)
    for k in range(200):
        blended = odometry.add_reckoned(k * TICK_NS, circle(0.05 * k, scale=1.2))
        seen = k - late
        if seen >= begins:
            odometry.add_slam(seen * TICK_NS, T_world_nav @ circle(0.05 * seen), 0)
    truth, start = circle(0.05 * 199), circle(0.05 * begins, scale=1.2)
    wrong = gap(inverse(circle(0.05 * begins)) @ truth, inverse(start) @ blended)
    reckoned_alone = 0.2 * 0.3 * 0.05 * (late + 1)  # 20 % of the way since SLAM's last pose
    assert wrong <= reckoned_alone + 0.05 * 0.3 + 1e-9


def test_a_new_segment_goes_on_where_dead_reckoning_got_to() -> None:
    odometry = BlendedOdometry()
    for k in range(20):
        odometry.add_reckoned(k * TICK_NS, circle(0.05 * k))
        odometry.add_slam(k * TICK_NS, circle(0.05 * k), 0)
    for k in range(20, 60):  # SLAM is lost
        odometry.add_reckoned(k * TICK_NS, circle(0.05 * k))
    elsewhere = se3(yaw_rotation(1.0), np.array([9.0, 9.0, 0.0]))
    odometry.add_slam(59 * TICK_NS, elsewhere, 1)
    assert gap(odometry.at(59 * TICK_NS), circle(0.05 * 59)) < 1e-9
    assert odometry.segment == 0


def test_without_an_imu_slam_is_the_odometry_and_a_new_segment_a_break() -> None:
    odometry = BlendedOdometry()
    for k in range(5):
        assert gap(odometry.add_slam(k * TICK_NS, circle(0.05 * k), 3), circle(0.05 * k)) < 1e-12
    assert odometry.segment == 0
    T = se3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    assert gap(odometry.add_slam(6 * TICK_NS, T, 4), T) < 1e-12
    assert odometry.segment == 1


def test_dead_reckoning_goes_on_for_minutes_without_slam() -> None:
    odometry = BlendedOdometry()
    for k in range(3000):
        blended = odometry.add_reckoned(k * TICK_NS, circle(0.05 * k))
        assert gap(blended, circle(0.05 * k)) < 1e-9


def test_slam_lost_for_minutes_the_path_goes_on_from_its_last_pose() -> None:
    odometry = BlendedOdometry()
    odometry.add_reckoned(0, circle(0.0))
    odometry.add_slam(0, circle(0.0), 0)
    for k in range(1, 3000):
        blended = odometry.add_reckoned(k * TICK_NS, circle(0.05 * k))
    assert gap(blended, circle(0.05 * 2999)) < 1e-9
