"""Two sides of a registration that say different things are seen."""

import numpy as np
import pytest

from shared.geometry import FloatArray, IntArray
from station.places.registration.parts import UNKNOWN, PartsApart, parts_apart
from station.places.registration.problem import make_problem
from tests.support.registration_clouds import CloudPair, make_pair

UNIT = 0.06  # three times the noise


@pytest.fixture(scope="module")
def pair() -> CloudPair:
    """Two drives of one flat."""
    return make_pair(9003, overlap=(0.9, 1.0), points=(5000, 6000))


def parts_of(pair: CloudPair, source: FloatArray, *, free_scale: bool = False, few: bool = False) -> PartsApart:
    """What parts of `source` say around the pair's true alignment."""
    T = pair.T_target_source
    assert T is not None
    problem = make_problem(pair.target, source, upright=True, free_scale=free_scale, rng=np.random.default_rng(0))
    subset: IntArray = np.arange(0, len(problem.source.points), 2) if not few else np.arange(40)
    return parts_apart(problem, T, subset=subset, reach=0.2, unit=UNIT)


def far_side(points: FloatArray) -> tuple[FloatArray, int]:
    """Which points lie beyond the middle of the cloud's longer extent, and along which axis that is."""
    axis = int(np.argmax(np.ptp(points[:, :2], axis=0)))
    return points[:, axis] > np.median(points[:, axis]), axis


def test_all_parts_of_a_right_alignment_agree(pair: CloudPair) -> None:
    parts = parts_of(pair, pair.source)
    assert parts.halves < 0.3 and parts.sides < 0.4
    assert parts.scales == pytest.approx(0.0, abs=1e-9)  # it is known


def test_sides_that_moved_against_each_other_disagree_by_as_much(pair: CloudPair) -> None:
    source = pair.source.copy()
    far, axis = far_side(source)
    source[far, axis] += 0.1
    parts = parts_of(pair, source)
    assert parts.sides * UNIT == pytest.approx(0.1, rel=0.4)
    assert parts.halves < 0.5 * parts.sides


def test_a_side_of_another_scale_is_seen_where_the_scale_is_free(pair: CloudPair) -> None:
    source = pair.source.copy()
    far, _ = far_side(source)
    middle = np.median(source[far], axis=0)
    source[far] = middle + 1.03 * (source[far] - middle)
    assert parts_of(pair, pair.source, free_scale=True).scales < 0.008
    assert parts_of(pair, source, free_scale=True).scales > 0.015


def test_parts_too_small_for_an_answer_say_nothing(pair: CloudPair) -> None:
    parts = parts_of(pair, pair.source, few=True)
    assert parts.halves == parts.sides == UNKNOWN
