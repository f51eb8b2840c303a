"""What an image says by its figures: measured odds, and what should be in view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.calibration import Calibration
from shared.geometry import se3, yaw_rotation
from station.places.space.space import Space
from station.places.tracking.belief import Belief, Hypothesis
from station.places.tracking.config import BeliefConfig
from station.places.tracking.image_evidence import ImageEvidence, MatchFigures, failure_probability, log_odds, support
from station.places.tracking.map_view import MapView
from station.places.tracking.sightings import Sightings
from tests.support.places import ODDS, R_BODY_CAM, SECOND, estimator_of, make_map, pose, seen
from tests.support.rooms import CAMERA, mapped, room_with_a_door, walls

USUAL = MatchFigures(extent_m=0.2, inliers=60, support=0.2, features=500, off_floor=1.0, is_free=True)


@given(
    extent_m=st.floats(0.02, 2.0),
    inliers=st.integers(16, 500),
    share=st.floats(0.01, 1.0),
    features=st.integers(60, 800),
    off_floor=st.floats(0.1, 1000.0),
    more=st.floats(1.1, 3.0),
)
def test_more_that_fits_speaks_for_a_pose_and_more_that_is_not_recognised_against_it(
    extent_m: float, inliers: int, share: float, features: int, off_floor: float, more: float
) -> None:
    figures = MatchFigures(extent_m, inliers, share, features, off_floor, is_free=True)
    odds = log_odds(ODDS.right, figures)
    assert log_odds(ODDS.right, replace(figures, extent_m=more * extent_m)) > odds
    assert log_odds(ODDS.right, replace(figures, inliers=int(np.ceil(more * inliers)))) > odds
    assert log_odds(ODDS.right, replace(figures, support=more * share)) > odds
    assert log_odds(ODDS.right, replace(figures, features=int(np.ceil(more * features)))) < odds
    assert log_odds(ODDS.right, replace(figures, off_floor=more * off_floor)) < odds


def test_a_view_with_next_to_nothing_in_it_has_finite_odds() -> None:
    assert np.isfinite(log_odds(ODDS.right, MatchFigures(0.0, 0, support(0.0, 0.0), 0, 0.0, is_free=False)))
    assert 0.0 < failure_probability(ODDS.fails_at_pose, 0, 1.0, 0.0) < 1.0


def test_no_more_can_be_recognised_than_is_in_view() -> None:
    assert support(49.0, 0.0) == support(100.0, 100.0) == 1.0 > support(49.0, 60.0)


@given(features=st.integers(60, 800), before=st.sampled_from([0.0, 0.5, 1.0]))
def test_a_failure_speaks_for_a_room_that_no_map_knows_and_against_a_known_view(features: int, before: float) -> None:
    at_pose, in_map, unmapped = (
        failure_probability(odds, features, before)
        for odds in (ODDS.fails_at_pose, ODDS.fails_in_map, ODDS.fails_unmapped)
    )
    assert at_pose < in_map < unmapped
    assert failure_probability(ODDS.fails_at_pose, features, before, in_view=0.0) > at_pose


def test_what_should_be_in_view_is_counted_where_the_camera_looks() -> None:
    place_map = room_with_a_door()
    sightings = Sightings(place_map, 1.0, Space.of(place_map.navigation))

    def at(x: float, y: float, yaw: float) -> float:
        T = se3(yaw_rotation(yaw), np.array([x, y, 0.0])) @ se3(R_BODY_CAM, np.zeros(3))
        return sightings.in_view(T, CAMERA)

    assert at(3.2, 2.0, np.pi) > 100  # across the room, from the ring
    assert at(50.0, 2.0, 0.0) == 0.0
    assert at(5.0, 2.0, np.pi / 2) < 0.3 * at(3.2, 2.0, np.pi)  # beyond the door, looking aside


@pytest.mark.parametrize("turned_rad", [0.0, 0.3])
def test_a_failure_tells_a_pose_from_others_only_while_its_heading_is_known(turned_rad: float) -> None:
    estimator = estimator_of(room_with_a_door())
    for k in range(5):
        estimator.on_candidates([seen(k, pose(3.2, 2.0, np.pi), landmarks=tuple(range(400)))])
    if turned_rad:
        estimator.on_odometry(4 * SECOND, pose(3.2, 2.0, np.pi))
        estimator.on_odometry(5 * SECOND, pose(3.2, 2.0, np.pi + turned_rad))

    def against_lost() -> float:
        now = estimator.place_probabilities()
        return (1 - now.lost - (now.unmapped - now.beyond)) / now.lost

    estimator.answer(5_500_000_000)
    before = against_lost()
    estimator.on_failure(5_500_000_000, 500)
    if turned_rad:
        assert against_lost() < 0.5 * before
    else:  # no odometry: 1.5 s after the last image it may look anywhere
        assert against_lost() == pytest.approx(before, rel=1e-3)


def test_an_image_that_fails_before_a_cupboard_says_little_against_where_the_robot_is() -> None:
    """Through what the map does not know to be free nothing is to be seen, whatever others saw from as near."""
    p = walls()
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = 2.0 + 1.2 * np.column_stack([np.cos(angle), np.sin(angle)])
    view = MapView.of(mapped(ring, 5 * angle, p[p[:, 0] > 0.1]))
    evidence = ImageEvidence([view], view.place_map.navigation.calibration, BeliefConfig())

    def fails(x: float) -> float:
        m = evidence.measured(seen(0.0, pose(x, 2.0)))
        belief = Belief((Hypothesis.started(m, np.eye(4), 1.0, 0.0, 1),), 0.0, 0.0)
        image = evidence.of_failure(400, 0.0, belief, np.eye(4), 1.0)
        assert image.alike[0].log_failed == pytest.approx(np.log(image.at[0] / image.lost))
        return image.at[0]

    assert fails(0.8) < 0.2 and fails(-0.5) > 5 * fails(0.8)


def test_without_a_camera_a_failure_is_as_likely_at_a_pose_as_anywhere_in_the_map() -> None:
    place_map = make_map()
    navigation = replace(place_map.navigation, calibration=Calibration(camera=None, imu=None))
    estimator = estimator_of(replace(place_map, navigation=navigation))
    estimator.on_odometry(0, pose(0.0, 0.0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0))])
    before = estimator.place_probabilities()
    estimator.on_odometry(SECOND, pose(0.4, 0.0))
    estimator.on_failure(SECOND, 500)
    after = estimator.place_probabilities()
    assert after.unmapped > before.unmapped
    assert after.lost / after.place.sum() == pytest.approx(before.lost / before.place.sum(), rel=0.2)


def test_lost_in_a_map_of_one_place_nothing_is_known() -> None:
    estimator = estimator_of(make_map(places=1))
    estimator.on_odometry(0, pose(0.0, 0.0))
    estimator.on_candidates([seen(0.0, pose(0.0, 0.0), inliers=200, extent=0.01, num_features=800)])
    assert estimator.place_probabilities().lost > 0.5
    assert estimator.answer(SECOND).state == "lost"


def test_a_chair_s_twin_before_another_wall_is_not_believed() -> None:
    """As large, with as many landmarks: but little of what should be in view is there."""
    chair = replace(USUAL, support=support(15, 450))
    alone = replace(USUAL, support=support(15, 15))
    assert log_odds(ODDS.right, chair) < -0.5 < 1.0 < log_odds(ODDS.right, alone)


@pytest.mark.parametrize("steps", [20, 400])
def test_odometrys_noise_grows_as_a_random_walk_however_often_it_comes(steps: int) -> None:
    usual = BeliefConfig()
    walk = replace(usual, drift=0.0)

    def after(distance_m: float, turn_rad: float, c: BeliefConfig) -> Hypothesis:
        h = Hypothesis(0, np.eye(4), 1.0, 0.03, 0.0, 1.0, 0, 0, 0)
        for _ in range(steps):
            h = h.grown(distance_m / steps, turn_rad / steps, c)
        return h

    assert after(1.0, 0.0, walk).sigma_m == pytest.approx(np.hypot(0.03, walk.walk_m_per_root_m))
    assert after(4.0, 0.0, walk).sigma_m == pytest.approx(np.hypot(0.03, 2 * walk.walk_m_per_root_m))
    assert after(0.0, np.pi, walk).sigma_rad == pytest.approx(walk.walk_rad_per_root_rad * np.sqrt(np.pi))
    # Wrong calibration and heading add up beside it.
    assert after(4.0, 0.0, usual).sigma_m == pytest.approx(after(4.0, 0.0, walk).sigma_m + 4.0 * usual.drift, rel=0.2)
