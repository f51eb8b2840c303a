"""A scale that is said to be known and is wrong is seen, though the clouds lie on each other nearly as well."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, scale_of
from station.places.registration import verify
from station.places.registration.freed_scale import free_the_scale, noise_of_scale
from station.places.registration.problem import RegistrationProblem, make_problem
from station.places.registration.register import register_clouds
from station.places.registration.sizes import odd_sizes
from tests.support.registration_clouds import CloudPair, make_pair


@pytest.fixture(scope="module")
def pair() -> CloudPair:
    """Two drives of one flat; training seed 520, accepted with a source 2 % too large until the scale was freed."""
    return make_pair(520, overlap=(0.5, 1.0), shared_landmarks=False)


def prepared(pair: CloudPair, factor: float, few: int | None = None) -> tuple[RegistrationProblem, FloatArray]:
    """Both clouds, the source `factor` times as large, and the motion that puts its middle where it belongs."""
    assert pair.T_target_source is not None
    rng = np.random.default_rng(0)
    source = pair.source if few is None else pair.source[rng.choice(len(pair.source), few, replace=False)]
    problem = make_problem(pair.target, factor * source, upright=True, free_scale=False, rng=rng)
    T = pair.T_target_source.copy()
    T[:3, 3] += (1.0 - factor) * T[:3, :3] @ np.median(source, axis=0)
    return problem, T


@pytest.mark.parametrize("factor", [0.95, 0.98, 1.02, 1.05])
def test_a_source_of_a_wrong_unit_is_refused_with_both_scales_and_a_remedy(pair: CloudPair, factor: float) -> None:
    result = register_clouds(pair.target, factor * pair.source)
    assert not result.accepted
    if abs(factor - 1.0) < 0.03:  # beyond it, other checks refuse some, too
        [reason] = result.reasons
        assert "given as 1," in reason and f"{result.measured['freed scale']:.4f}" in reason
        assert "--scale free" in reason
        assert result.measured["freed scale"] == pytest.approx(1 / factor, abs=0.006)
        assert 0 < result.measured["freed scale's noise"] < 0.003


def test_a_scale_known_less_well_may_be_off_by_more(pair: CloudPair) -> None:
    result = register_clouds(pair.target, 1.02 * pair.source, known_to=0.03)
    assert result.accepted, result.reasons
    assert result.scale == pytest.approx(1.0, abs=1e-9)
    assert result.measured["freed scale"] == pytest.approx(1 / 1.02, abs=0.006)


def test_a_right_scale_stays_where_it_is_and_is_measured(pair: CloudPair) -> None:
    result = register_clouds(pair.target, pair.source)
    assert result.accepted, result.reasons
    assert result.scale == pytest.approx(1.0, abs=1e-9)
    assert result.measured["freed scale"] == pytest.approx(1.0, abs=0.004)
    assert "freed scale's noise" not in result.measured  # not worth its time


def test_where_the_scale_is_free_it_is_found_and_not_checked_again(pair: CloudPair) -> None:
    result = register_clouds(pair.target, 1.03 * pair.source, scale="free")
    assert result.accepted, result.reasons
    assert result.scale == pytest.approx(1 / 1.03, rel=0.004)
    assert "freed scale" not in result.measured


@pytest.mark.parametrize("factor", [0.98, 1.0, 1.03])
def test_a_freed_scale_goes_back_by_what_the_source_is_too_large(pair: CloudPair, factor: float) -> None:
    problem, T = prepared(pair, factor)
    freed = free_the_scale(problem, T, subset=np.arange(len(problem.source.points)))
    assert freed is not None
    assert scale_of(freed) == pytest.approx(1 / factor, abs=0.004)


def test_fewer_points_know_the_scale_less_well(pair: CloudPair) -> None:
    noise = []
    for few in (4000, 400):
        problem, T = prepared(pair, 1.0, few)
        of_parts = noise_of_scale(problem, T, subset=np.arange(len(problem.source.points)))
        assert of_parts is not None
        noise.append(of_parts)
    assert 0 < noise[0] < 0.002 and noise[1] > 2 * noise[0]


def test_clouds_that_hardly_meet_say_nothing_of_the_scale(pair: CloudPair) -> None:
    problem, T = prepared(pair, 1.0)
    T[:3, 3] += 100.0
    assert free_the_scale(problem, T, subset=np.arange(200)) is None
    assert noise_of_scale(problem, T, subset=np.arange(200)) is None


def test_a_scale_that_moves_no_farther_than_its_noise_explains_is_no_wrong_one(
    pair: CloudPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = 1.02 * pair.source
    for noise, accepted in ((0.004, False), (0.01, True), (None, True)):
        monkeypatch.setattr(verify, "noise_of_scale", lambda *_, noise=noise, **__: noise)
        assert register_clouds(pair.target, source).accepted is accepted, noise


def test_the_benchmark_s_wrong_units_are_as_large_as_asked_and_change_no_other_set() -> None:
    for seed in range(520, 526):
        right = make_pair(seed, points=(500, 600))
        wrong = make_pair(seed, points=(500, 600), unit_error=(0.02, 0.05))
        assert right.T_target_source is not None and wrong.T_target_source is not None
        np.testing.assert_array_equal(right.target, wrong.target)
        factor = 1 / scale_of(wrong.T_target_source)
        assert 0.02 <= abs(factor - 1) <= 0.05
        np.testing.assert_allclose(wrong.source, factor * right.source)
        landed = wrong.source @ wrong.T_target_source[:3, :3].T + wrong.T_target_source[:3, 3]
        expected = right.source @ right.T_target_source[:3, :3].T + right.T_target_source[:3, 3]
        np.testing.assert_allclose(landed, expected, atol=1e-9)


@pytest.mark.parametrize(("factor", "helps"), [(3.28, False), (20.0, True)])
def test_scale_free_is_advised_only_where_it_would_look(factor: float, helps: bool) -> None:
    p = np.random.default_rng(0).normal(size=(500, 3))
    [sentence] = odd_sizes(p, factor * p, "known", (1.0, 1.0))
    assert "convert one" in sentence and ("scale free" in sentence) == helps
