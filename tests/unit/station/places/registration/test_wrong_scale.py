"""A scale that is said to be known and is wrong is seen, though the clouds lie on each other nearly as well."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import scale_of
from station.places.registration import verify
from station.places.registration.register import register_clouds
from station.places.registration.sizes import odd_sizes
from tests.support.registration_clouds import CloudPair, make_pair


@pytest.fixture(scope="module")
def pair() -> CloudPair:
    """Two drives of one flat; training seed 520, accepted with a source 2 % too large until the scale was freed."""
    return make_pair(520, overlap=(0.5, 1.0), shared_landmarks=False)


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


@pytest.mark.parametrize(("noise", "accepted"), [(0.004, False), (0.01, True), (0.02, False), (None, True)])
def test_a_scale_that_moves_no_farther_than_its_noise_explains_is_no_wrong_one_where_it_is_known_well(
    pair: CloudPair, monkeypatch: pytest.MonkeyPatch, noise: float | None, accepted: bool
) -> None:
    covariance = None if noise is None else np.diag([1e-6] * 6 + [noise**2])
    monkeypatch.setattr(verify, "spread_of", lambda *_: covariance)
    assert register_clouds(pair.target, 1.02 * pair.source).accepted is accepted


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
