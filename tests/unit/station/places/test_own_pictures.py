"""A map's own pictures say how much in it looks alike, and by that every pose in it is judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.model.place_answer import Localization
from station.places.localisation.tried_pictures import TriedPicture, tried_arrays, tried_of_arrays
from station.places.tracking.belief import Belief
from station.places.tracking.current import CurrentPlaceEstimator
from station.places.tracking.image_evidence import MatchFigures
from station.places.tracking.map_view import MapView
from station.places.tracking.own_pictures import Judged, fitted_to_own, judged, own_log_odds
from tests.support.places import CONFIG, ODDS, make_map, pose, seen

FIGURES = MatchFigures(extent_m=0.2, inliers=40, support=0.2, features=400, off_floor=1.0, is_free=True)


def pictures_of(right: int, wrong: int) -> list[Judged]:
    return [Judged((FIGURES,), 0)] * right + [Judged((FIGURES,), None)] * wrong


def own(right: int, wrong: int, tried: float = 0.0) -> float:
    return fitted_to_own(pictures_of(right, wrong), ODDS.right, ODDS.usual, tried)


@given(right=st.integers(0, 60), wrong=st.integers(0, 60))
def test_more_wrong_poses_make_every_pose_of_the_map_less_likely(right: int, wrong: int) -> None:
    assert own(right, wrong + 1) < own(right, wrong) < own(right + 1, wrong)


def test_a_map_without_pictures_is_like_those_that_the_odds_were_fitted_to() -> None:
    assert own(0, 0) == 0.0


def test_pictures_that_are_all_right_make_no_pose_likelier() -> None:
    assert own_log_odds(pictures_of(90, 0), ODDS.right, ODDS.usual, 0.0) == 0.0 < own(90, 0)
    assert own_log_odds(pictures_of(0, 90), ODDS.right, ODDS.usual, 0.0) == own(0, 90) < 0.0


def test_few_pictures_say_less_than_many() -> None:
    assert abs(own(1, 1)) < abs(own(30, 30))


def test_what_all_maps_own_pictures_have_in_common_is_no_maps_own() -> None:
    as_fitted = own(30, 30)
    assert abs(own(30, 30, tried=as_fitted)) < 0.2 * abs(as_fitted)


def wrong_at(x: float, times: int) -> list[TriedPicture]:
    """The map's pictures from 6 m, each of which looks like what stands at `x`."""
    found = replace(seen(0.0, pose(x, 0.0), inliers=40, landmarks=(0, 1)), map_id="")
    return [TriedPicture(seen(0.0, pose(6.0, 0.0)).T_map_cam, (found,))] * times


def test_a_pose_is_judged_by_where_its_picture_was_taken() -> None:
    view = MapView.of(make_map())
    assert [one.right for one in judged(view, wrong_at(0.0, 2))] == [None, None]
    assert [one.right for one in judged(view, wrong_at(6.1, 1))] == [0]


def belief_after_one_image(tried: list[TriedPicture]) -> Belief:
    estimator = CurrentPlaceEstimator([make_map()], config=CONFIG, tried=[tried])
    estimator.on_candidates([seen(1.0, pose(3.0, 0.0), inliers=60, extent=0.1, landmarks=(1,))])
    return estimator._belief


def test_in_a_home_where_much_looks_alike_an_image_says_less() -> None:
    as_usual, alike = belief_after_one_image([]), belief_after_one_image(wrong_at(0.0, 40))
    assert alike.localised < 0.9 * as_usual.localised


def test_each_of_two_maps_has_its_own() -> None:
    def share_of_plain(tried_in_plain: list[TriedPicture]) -> float:
        estimator = CurrentPlaceEstimator([make_map("a"), make_map("plain")], config=CONFIG, tried=[[], tried_in_plain])
        both = [
            seen(1.0, pose(3.0, 0.0), inliers=60, extent=0.1, map_id=name, landmarks=(1,)) for name in ("a", "plain")
        ]
        estimator.on_candidates(both)
        weights = {h.map_index: h.weight for h in estimator._belief.hypotheses}
        return weights[1] / (weights[0] + weights[1])

    assert share_of_plain([]) == pytest.approx(0.5)
    assert share_of_plain(wrong_at(0.0, 40)) < 0.3


candidate = st.builds(
    lambda x, inliers, landmarks: replace(
        seen(0.0, pose(x, 0.0), inliers=inliers, landmarks=tuple(landmarks)), map_id=""
    ),
    st.floats(-9, 9),
    st.integers(10, 500),
    st.lists(st.integers(0, 2**40), max_size=5),
)


@given(st.lists(st.lists(candidate, min_size=1, max_size=3), max_size=4))
def test_pictures_come_back_from_their_arrays(found: list[list[Localization]]) -> None:
    tried = [TriedPicture(pose(k, 0.0), tuple(candidates)) for k, candidates in enumerate(found)]
    again = tried_of_arrays(tried_arrays(tried))
    assert len(again) == len(tried)
    for one, other in zip(again, tried, strict=True):
        assert np.array_equal(one.T_map_cam, other.T_map_cam) and len(one.candidates) == len(other.candidates)
        for z, before in zip(one.candidates, other.candidates, strict=True):
            assert np.array_equal(z.T_map_cam, before.T_map_cam) and np.array_equal(z.landmarks, before.landmarks)
            assert (z.num_inliers, z.extent, z.num_features) == (before.num_inliers, before.extent, before.num_features)
