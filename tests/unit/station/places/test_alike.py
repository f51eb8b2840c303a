"""Rooms that look alike, both in the map: one of two until something tells them apart, never a guess."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from station.model.place_answer import Localization, PlaceAnswer
from station.places.tracking.alike import UNRIVALLED, Alike
from station.places.tracking.belief import Agreement, Hypothesis
from station.places.tracking.current import CurrentPlaceEstimator
from station.places.tracking.image_evidence import ImageEvidence
from station.places.tracking.map_view import MapView
from station.places.tracking.twins import Twins
from tests.support.places import CONFIG, SECOND, estimator_of, make_map, pose, seen
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
    assert rooms_of(answer)["room-l"] > 0.15
    later = look(tracked, 7, at(HERE_X, 7, 150), at(THERE_X, 7, 150))
    assert rooms_of(later)["room-l"] > 0.15


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
    assert rooms_of(answer)["room-k"] > 0.15


def test_what_is_as_small_as_furniture_makes_no_twins() -> None:
    small = UNRIVALLED.and_both({7: 0.05}, 1.0, 1.0)
    large = UNRIVALLED.and_both({7: 1.0}, 1.0, 1.0)
    assert small.of(7) < 0.05 < 0.7 < large.of(7)
    assert UNRIVALLED.of(7) == UNRIVALLED.and_one({7}, 1.0).of(7) == 0.0
    assert large.and_one({7}, 1.0).of(7) < large.of(7)


@pytest.mark.parametrize("freshness", [1.0, 0.5, 0.25])
def test_what_images_say_of_twins_is_their_mean(freshness: float) -> None:
    alike, total = UNRIVALLED, 0.0
    for log_ratio in (1.0, 0.4, 0.7) * round(1 / freshness):
        total += freshness * alike.tempered(log_ratio, freshness)
        alike = alike.and_both({7: 1.0}, log_ratio, freshness)
    assert total == pytest.approx(0.7) and alike.mean == pytest.approx(0.7)


def hypotheses(here: float, there: float, /, **alike: Alike) -> tuple[Hypothesis, ...]:
    """Of weights at the same spot of both twins, numbers 1 and 2."""
    evidence = ImageEvidence([MapView.of(make_map())], None, CONFIG)
    return tuple(
        replace(
            Hypothesis.started(evidence.measured(seen(0.0, pose(x, 0.0))), np.eye(4), weight, 0.0, number),
            alike=alike.get(name, UNRIVALLED),
        )
        for number, x, weight, name in ((1, HERE_X, here, "here"), (2, THERE_X, there, "there"))
    )


def image_of_both(hypotheses: Sequence[Hypothesis], large: float = 1.0) -> Twins:
    apart = Agreement(np.inf, 0.0)
    fits = [[Agreement(0.0, 100.0), apart], [apart, Agreement(0.0, 100.0)]]
    return Twins(hypotheses, fits, np.full(2, 0.5), np.full(2, large), 1.0)


def levelled(*hypotheses: Hypothesis) -> list[float]:
    """Their weights after an image that fits both equally."""
    twins = image_of_both(hypotheses)
    factors = twins.levelled([1.0, 1.0], twins.after([0, 1], 0.5))
    return [h.weight * factor for h, factor in zip(hypotheses, factors, strict=True)]


def test_what_told_twins_apart_before_both_were_seen_counts_no_more_and_nobody_else_pays() -> None:
    here, there = levelled(*hypotheses(0.8, 0.01))
    assert here + there == pytest.approx(0.81)
    assert there > 0.3


def test_images_that_failed_at_one_of_two_twins_keep_them_apart() -> None:
    failed = UNRIVALLED.and_failed(1 / 30, 1.0)
    here, there = levelled(*hypotheses(0.94, 0.03, there=failed))
    assert here / there > 15


def test_images_that_were_recognised_at_one_of_two_only_keep_them_apart() -> None:
    here, there = levelled(*hypotheses(0.94, 0.001, here=UNRIVALLED.and_alone(0.1, 2.0)))
    assert here / there > 50


def test_furniture_that_comes_twice_is_neither_tempered_nor_levelled() -> None:
    both = hypotheses(0.94, 0.03, here=UNRIVALLED.and_both({2: 1.0}, 1.0, 1.0))
    assert image_of_both(both, large=0.0).tempering == pytest.approx([1.0, 1.0])
    assert image_of_both(both).tempering[0] < 0.7  # a second image moves the mean by half
    small = image_of_both(hypotheses(0.94, 0.03), large=0.001)
    assert small.levelled([1.0, 1.0], small.after([0, 1], 0.5)) == pytest.approx([1.0, 1.0])


def test_rivals_that_are_no_more_are_forgotten() -> None:
    gone = UNRIVALLED.and_both({2: 1.0, 9: 1.0}, 0.0, 1.0)
    here, _ = image_of_both(hypotheses(0.5, 0.5, here=gone)).after([0, 1], 0.5)
    assert set(here.fit_both) == set(here.fit_one) == {2}


def test_the_two_halves_of_one_that_may_have_slipped_are_no_rivals() -> None:
    one, half = hypotheses(0.5, 0.4)
    here, _ = image_of_both((one, replace(half, number=one.number))).after([0, 1], 0.5)
    assert not here.fit_both


def test_failures_are_asked_for_only_where_an_image_fits_one_of_two_that_look_alike() -> None:
    alike = UNRIVALLED.and_both({2: 1.0}, 0.0, 1.0)
    fits = [[Agreement(0.0, 100.0)], [Agreement(np.inf, 0.0)]]

    def asks(*both: Hypothesis) -> bool:
        return Twins(both, fits, np.ones(1), np.ones(1), 1.0).fits_one_of_alike

    assert asks(*hypotheses(0.5, 0.5, here=alike)) and not asks(*hypotheses(0.5, 0.5))
    assert not image_of_both(hypotheses(0.5, 0.5, here=alike)).fits_one_of_alike
