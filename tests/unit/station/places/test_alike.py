"""Rooms that look alike, both in the map: one of two until something tells them apart, never a guess."""

from __future__ import annotations

import numpy as np
import pytest

from station.model.place_answer import Localization, PlaceAnswer
from station.places.tracking.alike import UNRIVALLED
from station.places.tracking.current import CurrentPlaceEstimator
from tests.support.places import SECOND, estimator_of, make_map, pose, seen
from tests.support.plans import with_two_rooms

STEP_RAD = 0.5  # between images: each shows something new
HERE_X, THERE_X = 0.5, 5.0  # the same spot of twin rooms
LANDMARKS = 400  # of the map, at random


def estimator() -> CurrentPlaceEstimator:
    more = np.random.default_rng(0).uniform([-1.0, -1.5, 0.0], [7.0, 1.5, 1.5], (LANDMARKS, 3))
    return estimator_of(with_two_rooms(make_map(more=more)))


def at(x: float, k: int, inliers: int, extent: float = 0.8) -> Localization:
    """Image k of a robot that turns on the spot at x."""
    first = 3 + 20 * k + (LANDMARKS // 2 if x == THERE_X else 0)
    return seen(0.5 * k, pose(x, 0.0, STEP_RAD * k), inliers, landmarks=tuple(range(first, first + 20)), extent=extent)


def look(estimator: CurrentPlaceEstimator, k: int, *seen: Localization) -> PlaceAnswer:
    t_ns = round(0.5 * k * SECOND)
    estimator.on_odometry(t_ns, pose(0.0, 0.0, STEP_RAD * k))
    estimator.on_candidates(seen)
    return estimator.answer(t_ns)


def rooms_of(answer: PlaceAnswer) -> dict[str, float]:
    rooms = (answer.room, *answer.room_alternatives) if answer.room else answer.room_alternatives
    return {room.id: room.probability for room in rooms}


def test_a_twin_that_was_mapped_with_more_landmarks_is_no_likelier_with_every_image() -> None:
    tracked = estimator()
    answers = [look(tracked, k, at(HERE_X, k, 120), at(THERE_X, k, 85)) for k in range(9)]
    for answer in answers:
        assert answer.room is None and len(answer.one_of_two) == 2
    assert sum(rooms_of(answers[-1]).values()) == pytest.approx(1.0, abs=0.01)
    assert rooms_of(answers[-1])["room-k"] == pytest.approx(rooms_of(answers[2])["room-k"], abs=0.1)


def test_one_image_that_is_recognised_in_one_of_two_twins_only_is_no_certainty() -> None:
    tracked = estimator()
    for k in range(6):
        look(tracked, k, at(HERE_X, k, 150), at(THERE_X, k, 150))
    without = estimator()
    assert look(without, 0, at(HERE_X, 0, 150)).room is not None  # nothing is known to look alike
    answer = look(tracked, 6, at(THERE_X, 6, 150))
    assert rooms_of(answer)["room-l"] > 0.02
    later = look(tracked, 7, at(HERE_X, 7, 150), at(THERE_X, 7, 150))
    assert rooms_of(later)["room-l"] > 0.02


def test_images_that_go_on_to_fit_one_of_two_only_tell_them_apart() -> None:
    tracked = estimator()
    for k in range(4):
        look(tracked, k, at(HERE_X, k, 150), at(THERE_X, k, 150))
    for k in range(4, 9):
        answer = look(tracked, k, at(THERE_X, k, 150))
    assert answer.room is not None and answer.room.id == "room-k"


def test_whoever_was_recognised_for_long_is_not_doubted_where_a_twin_comes_into_view() -> None:
    tracked = estimator()
    for k in range(5):
        look(tracked, k, at(HERE_X, k, 150))
    for k in range(5, 9):
        answer = look(tracked, k, at(HERE_X, k, 150), at(THERE_X, k, 150))
    assert answer.room is not None and answer.room.id == "room-l"


def test_a_first_image_that_misses_the_twin_does_not_decide() -> None:
    tracked = estimator()
    look(tracked, 0, at(HERE_X, 0, 150))
    for k in range(1, 7):
        answer = look(tracked, k, at(HERE_X, k, 150), at(THERE_X, k, 150))
    assert rooms_of(answer)["room-k"] > 0.02


def test_what_is_as_small_as_furniture_makes_no_twins() -> None:
    small = UNRIVALLED.and_both({7: 0.05}, 1.0, 1.0)
    large = UNRIVALLED.and_both({7: 1.0}, 1.0, 1.0)
    assert small.of(7) < 0.05 < 0.7 < large.of(7)
    assert UNRIVALLED.of(7) == UNRIVALLED.and_either({7}, 1.0).of(7) == 0.0
    assert large.and_either({7}, 1.0).of(7) < large.of(7)


def test_what_images_say_of_twins_is_their_mean() -> None:
    alike, total = UNRIVALLED, 0.0
    for said in (1.0, 0.4, 0.7):
        total += alike.tempered(said, 1.0)
        alike = alike.and_both({7: 1.0}, said, 1.0)
    assert total == pytest.approx(0.7) and alike.mean == pytest.approx(0.7)
