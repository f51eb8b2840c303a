"""What images say that were not recognised: of a view that is new, of one that comes again, and in the dark."""

from __future__ import annotations

import numpy as np
import pytest

from shared.calibration import REFERENCE_HEAD
from shared.geometry import FloatArray
from shared.head import turned
from station.motion.head import AHEAD, Aim
from tests.support.places import SECOND, estimator_of, make_map, pose, seen


def test_failed_views_make_the_robot_doubt_the_map() -> None:
    estimator = estimator_of(make_map())
    for k in range(12):
        estimator.on_odometry(k * SECOND, pose(0, 0, 0.4 * k))
        estimator.on_failure(k * SECOND, num_features=400)
    answer = estimator.answer(12 * SECOND)
    assert answer.state == "unknown"
    assert answer.place is None


def test_a_robot_that_stands_still_before_a_view_it_does_not_know_keeps_its_place() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    for k in range(1, 240):
        estimator.on_odometry(k * SECOND // 4, pose(0.0, 0.0, 2.0))
        estimator.on_failure(k * SECOND // 4, num_features=400)
    answer = estimator.answer(60 * SECOND)
    assert answer.state == "known" and answer.place is not None and answer.place.id == "map-0"


def _looking(yaw: float, with_head: bool) -> tuple[FloatArray, Aim]:
    """Where body and camera are while one of them is turned."""
    return (pose(0.0, 0.0), Aim(turned(REFERENCE_HEAD, yaw, 0.0), 0.05)) if with_head else (pose(0.0, 0.0, yaw), AHEAD)


@pytest.mark.parametrize("with_head", [True, False])
def test_a_robot_that_looks_about_at_what_it_does_not_know_loses_its_place(with_head: bool) -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    for k in range(1, 14):
        T_nav_body, aim = _looking(0.2 * k - 1.4, with_head)
        estimator.on_odometry(k * SECOND // 2, T_nav_body)
        estimator.on_failure(k * SECOND // 2, num_features=400, aim=aim)
    assert estimator.answer(7 * SECOND).state == "unknown"


@pytest.mark.parametrize("with_head", [True, False])
def test_a_robot_that_looks_to_and_fro_at_what_it_does_not_know_keeps_its_place(with_head: bool) -> None:
    """Whatever it looks at again tells nothing new: a minute of it no more than a look to either side."""
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    believed = []
    for k in range(1, 121):
        T_nav_body, aim = _looking((0.5, -0.5)[k % 2], with_head)
        estimator.on_odometry(k * SECOND // 2, T_nav_body)
        estimator.on_failure(k * SECOND // 2, num_features=400, aim=aim)
        believed.append(1 - estimator.place_probabilities().unmapped)
    assert believed[1] < believed[0] - 1e-3  # the other side is new
    assert believed[-1] == pytest.approx(believed[1], abs=0.01)
    assert estimator.answer(60 * SECOND).state == "known"


def test_what_is_not_recognised_where_it_was_before_speaks_against_the_place() -> None:
    """Somebody may have moved the robot, and no sensor noticed; or the map is old."""
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    unmapped = [estimator.place_probabilities().unmapped]
    for k, aside in enumerate((0.6, 0.0, 0.6, 0.0), start=1):
        estimator.on_odometry(k * SECOND, pose(0, 0, aside))
        estimator.on_failure(k * SECOND, num_features=400)
        unmapped.append(estimator.place_probabilities().unmapped)
    assert np.diff(unmapped)[:2].min() > 1e-3  # beside it, and where it was recognised
    assert np.abs(np.diff(unmapped)[2:]).max() < 1e-3  # the same again


def test_a_covered_lens_is_no_evidence() -> None:
    estimator = estimator_of(make_map())
    estimator.on_odometry(0, pose(0, 0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    before = estimator.place_probabilities().unmapped
    for k in range(1, 30):
        estimator.on_odometry(k * SECOND // 2, pose(0, 0))
        estimator.on_failure(k * SECOND // 2, num_features=3)
    assert estimator.answer(15 * SECOND).state == "known"
    assert estimator.place_probabilities().unmapped == pytest.approx(before, abs=0.01)
