"""Whether an answer stays when blocks of space are drawn anew: which alignment wins, and how far the answer moves."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, IntArray, so3_log
from station.places.registration.bootstrap import Rivalry, compare, spread_of
from station.places.registration.problem import RegistrationProblem, make_problem
from station.places.registration.refine import refine
from station.places.registration.score import score_alignment
from tests.support.registration_clouds import CloudPair, make_pair


@pytest.fixture(scope="module")
def pair() -> CloudPair:
    """Two drives of one flat."""
    return make_pair(9003, overlap=(0.9, 1.0), points=(5000, 6000))


def problem_of(pair: CloudPair, source: FloatArray, *, free_scale: bool = False) -> RegistrationProblem:
    return make_problem(pair.target, source, upright=True, free_scale=free_scale, rng=np.random.default_rng(0))


def settled(problem: RegistrationProblem, T: FloatArray | None) -> FloatArray:
    """The optimum (4, 4) at the pair's true alignment."""
    assert T is not None
    every: IntArray = np.arange(len(problem.source.points))
    return refine(problem, T, subset=every, reaches=(0.6 * problem.voxel,) * 8, tolerance=1e-6).T_target_source


def sigmas(covariance: FloatArray | None) -> FloatArray:
    assert covariance is not None
    return np.asarray(np.sqrt(np.diag(covariance)))


def compare_shifted(pair: CloudPair, *shifts: float) -> Rivalry:
    """The true alignment against others that are shifted by so much (m)."""
    problem = problem_of(pair, pair.source)
    subsets = problem.draw_subsets(1500)
    T = settled(problem, pair.T_target_source)
    rivals = []
    for shift in shifts:
        moved = T.copy()
        moved[0, 3] += shift
        rivals.append(score_alignment(problem, moved, subsets))
    return compare(problem, T, score_alignment(problem, T, subsets), rivals, subsets)


def test_an_alignment_beside_the_right_one_wins_no_draw(pair: CloudPair) -> None:
    assert compare_shifted(pair, 0.15, -0.3).mass == 0.0


def test_a_rival_that_explains_as_much_elsewhere_wins_many_draws_and_counts_once(pair: CloudPair) -> None:
    rivals = compare_shifted(pair, 0.15, 1e-5, -1e-5)
    assert rivals.shares[0] == 0.0
    assert rivals.shares[1] + rivals.shares[2] > 0.5
    assert rivals.shares.max() <= rivals.mass <= 1.0


def test_without_rivals_nothing_is_lost(pair: CloudPair) -> None:
    assert compare_shifted(pair).mass == 0.0


def test_a_known_scale_does_not_spread_and_a_free_one_does(pair: CloudPair) -> None:
    for free_scale in (False, True):
        problem = problem_of(pair, pair.source, free_scale=free_scale)
        covariance = spread_of(problem, settled(problem, pair.T_target_source))
        assert covariance is not None and covariance.shape == (7, 7)
        assert (sigmas(covariance)[:6] > 0).all()
        assert (covariance[6, 6] > 0) == free_scale
        np.testing.assert_allclose(covariance, covariance.T)


def test_the_spread_is_about_how_far_the_answer_is_off(pair: CloudPair) -> None:
    problem = problem_of(pair, pair.source)
    T = settled(problem, pair.T_target_source)
    sigma = sigmas(spread_of(problem, T))
    T_true = pair.T_target_source
    assert T_true is not None
    off = np.linalg.norm((T - T_true)[:3] @ np.append(np.median(pair.source, axis=0), 1.0))
    turn = np.linalg.norm(so3_log(T[:3, :3] @ T_true[:3, :3].T))
    assert 0.2 < off / np.linalg.norm(sigma[3:6]) < 5 and turn / np.linalg.norm(sigma[:3]) < 5


def test_fewer_points_know_the_alignment_less_well(pair: CloudPair) -> None:
    rng = np.random.default_rng(0)
    spread = []
    for few in (4000, 400):
        problem = problem_of(pair, pair.source[rng.choice(len(pair.source), few, replace=False)], free_scale=True)
        spread.append(sigmas(spread_of(problem, settled(problem, pair.T_target_source))))
    assert np.linalg.norm(spread[1][3:6]) > 1.5 * np.linalg.norm(spread[0][3:6])
    assert spread[1][6] > 1.5 * spread[0][6]


def test_clouds_that_hardly_meet_have_no_spread(pair: CloudPair) -> None:
    problem = problem_of(pair, pair.source)
    apart = np.eye(4)
    apart[0, 3] = 100.0
    assert spread_of(problem, apart) is None
