"""The map from views: where its views' head was on the body."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from shared.calibration import REFERENCE_HEAD
from station.motion.head import NUM_ERRORS, PAN_KNOTS, PLAY, HeadPose, HeadThen
from station.slam.ukf.map.view_map import _are_placed, head_terms


def view(head: HeadThen | None, as_known_then: HeadPose | None = None) -> Any:
    T = None if as_known_then is None else as_known_then.T_body_head(np.zeros(2))
    return SimpleNamespace(keyframe=SimpleNamespace(head=head, T_body_head=T))


def test_the_map_has_the_head_where_the_drives_end_knows_it_to_have_been() -> None:
    """Of the first turn's views the filter knew the servos' errors too late."""
    told = HeadPose(REFERENCE_HEAD, np.array([0.5, 0.0]), np.zeros(2), np.zeros(2))
    play = np.array([0.004, -0.002])
    errors = np.zeros(NUM_ERRORS)
    errors[PLAY], errors[2 : 2 + len(PAN_KNOTS)] = 0.02, 0.1 * PAN_KNOTS  # the play of now is not that of then
    terms = head_terms([view(None), view(HeadThen(told, play), told)], errors)
    assert terms is not None
    truly = told.T_body_head(np.array([0.05, 0.0]) + play)
    np.testing.assert_allclose(terms.R_body_head[1], truly[:3, :3], atol=1e-12)
    np.testing.assert_allclose(terms.t_body_head[1], truly[:3, 3], atol=1e-12)
    assert (terms.R_body_head[0] == np.eye(3)).all() and not terms.axes[0].any()  # before it was turned


def test_a_head_that_was_never_turned_adds_nothing_to_the_map() -> None:
    assert head_terms([view(None), view(None)], np.zeros(NUM_ERRORS)) is None


def test_views_of_which_most_show_next_to_nothing_place_no_keyframes() -> None:
    """The filter has followed tracks there; the map would know of the IMU and the wheels only."""
    views: Any = range(5)
    for shown, expected in (([3, 3, 3, 0, 0], True), ([9, 9, 2, 2, 2], False)):
        landmarks: Any = SimpleNamespace(observed_keyframe=np.repeat(np.arange(5), shown))
        assert _are_placed(views, landmarks) == expected
