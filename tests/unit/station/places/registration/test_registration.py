"""Registration of clouds: recovers motions, refuses what it cannot know."""

from __future__ import annotations

import numpy as np
import pytest

from shared.errors import DataError
from shared.geometry import FloatArray, scale_of, se3, yaw_rotation
from station.places.registration.beside import alignments_beside, best_fits, surface_fit
from station.places.registration.cloud import prepare_cloud
from station.places.registration.problem import make_problem
from station.places.registration.register import register_clouds
from station.places.registration.yaw_search import make_searches
from tests.support.registration_clouds import errors, make_pair


@pytest.mark.parametrize("seed", [9001, 9002])
def test_two_drives_of_one_flat_are_registered(seed: int) -> None:
    pair = make_pair(seed, overlap=(0.7, 1.0), points=(3000, 6000))
    assert pair.T_target_source is not None
    result = register_clouds(pair.target, pair.source)
    assert result.accepted, result.reasons
    assert result.T_target_source is not None
    rotation_deg, shift, _ = errors(result.T_target_source, pair.T_target_source, np.median(pair.source, axis=0))
    assert rotation_deg < 2 and shift < 0.05


def test_a_free_scale_is_found_together_with_the_motion() -> None:
    pair = make_pair(9003, overlap=(0.8, 1.0), points=(3000, 5000), scale_range=0.2)
    assert pair.T_target_source is not None
    result = register_clouds(pair.target, pair.source, scale="free")
    assert result.accepted, result.reasons
    assert result.T_target_source is not None
    rotation_deg, shift, scale = errors(result.T_target_source, pair.T_target_source, np.median(pair.source, axis=0))
    assert rotation_deg < 2 and shift < 0.05 and scale < 0.01
    assert result.scale == pytest.approx(scale_of(result.T_target_source))


def test_clouds_of_different_flats_are_refused_with_a_reason() -> None:
    pair = make_pair(9004, same_flat=False, points=(3000, 5000))
    result = register_clouds(pair.target, pair.source)
    assert not result.accepted
    assert result.reasons


@pytest.mark.parametrize(("shift", "turn_deg", "scale"), [((0.3, 0.0), 0.0, 1.0), ((-0.2, 0.2), 4.0, 1.02)])
def test_from_an_alignment_beside_the_right_one_the_right_one_is_seen(
    shift: tuple[float, float], turn_deg: float, scale: float
) -> None:
    pair = make_pair(9003, overlap=(0.8, 1.0), points=(3000, 5000))
    assert pair.T_target_source is not None
    problem = make_problem(pair.target, pair.source, upright=True, free_scale=True, rng=np.random.default_rng(0))
    count = len(problem.source.points)
    at = np.median(problem.source.points, axis=0)
    beside = se3(scale * yaw_rotation(np.radians(turn_deg)) @ pair.T_target_source[:3, :3], np.zeros(3))
    beside[:3, 3] = (pair.T_target_source[:3, :3] - beside[:3, :3]) @ at + pair.T_target_source[:3, 3] + [*shift, 0]
    found = alignments_beside(problem, beside, subset=np.arange(0, count, 3), few=np.arange(0, count, 12))
    missed = [errors(refined.T_target_source, pair.T_target_source, at) for refined in found]
    assert any(rotation < 2 and shift_m < 0.05 and relative < 0.01 for rotation, shift_m, relative in missed)


def test_without_noise_the_error_is_almost_zero() -> None:
    cloud = make_pair(9005, overlap=(1.0, 1.0), points=(4000, 4001), noise_m=0.0, outliers=(0.0, 0.0)).target
    T_true = se3(yaw_rotation(2.5), np.array([1.0, -2.0, 0.3]))
    result = register_clouds(cloud, (cloud - T_true[:3, 3]) @ T_true[:3, :3])
    assert result.accepted
    assert result.T_target_source is not None
    rotation_deg, shift, _ = errors(result.T_target_source, T_true, np.zeros(3))
    assert rotation_deg < 1e-3 and shift < 1e-4


def test_same_input_and_seed_give_the_same_answer() -> None:
    pair = make_pair(9006, points=(3000, 4000))
    a, b = (register_clouds(pair.target, pair.source, seed=5) for _ in range(2))
    assert np.array_equal(a.T_target_source, b.T_target_source)  # type: ignore[arg-type]


def box(rng: np.random.Generator, n: int = 3000) -> FloatArray:
    p = rng.uniform(0, 1, (n, 3)) * [4.0, 3.0, 2.5]
    wall = rng.integers(0, 3, n)
    p[np.arange(n), wall] = np.round(p[np.arange(n), wall] / [4, 3, 2.5][0]) * np.array([4, 3, 2.5])[wall]
    return p


@pytest.mark.parametrize(
    ("cloud", "word"),
    [
        (np.zeros((0, 3)), "0 usable points"),
        (np.zeros((1, 3)), "1 usable points"),
        (np.full((500, 3), np.nan), "no finite point"),
        (np.zeros((500, 3)), "coincide"),
        (np.outer(np.linspace(0, 1, 500), [1.0, 2.0, 0.5]), "one line"),
        (np.column_stack([np.random.default_rng(0).uniform(0, 3, (500, 2)), np.zeros(500)]), "one plane"),
    ],
)
def test_a_cloud_that_fixes_nothing_is_refused_in_a_sentence(cloud: FloatArray, word: str) -> None:
    good = box(np.random.default_rng(1))
    for target, source in ((good, cloud), (cloud, good)):
        result = register_clouds(target, source)
        assert not result.accepted and result.T_target_source is None
        assert word in result.reasons[0]


def test_clouds_in_different_units_are_named_as_such() -> None:
    pair = make_pair(9007, points=(3000, 3500))
    result = register_clouds(pair.target, pair.source * 1000)
    assert not result.accepted
    assert "units" in result.reasons[0]


@pytest.mark.parametrize("factor", [3.28, 0.1, 39.37])
def test_a_refusal_of_clouds_that_may_be_in_feet_or_inches_mentions_units(factor: float) -> None:
    pair = make_pair(9007, points=(3000, 3500))
    result = register_clouds(pair.target, pair.source * factor)
    assert not result.accepted
    assert "units" in result.reasons[-1] and "times the" in result.reasons[-1]


def test_a_free_scale_that_cannot_reach_feet_says_which_scales_were_tried() -> None:
    pair = make_pair(9007, points=(3000, 3500))
    result = register_clouds(pair.target, pair.source * 3.28, scale="free")
    assert not result.accepted
    assert "units" in result.reasons[-1] and "0.78 to 1.28" in result.reasons[-1]


def test_a_source_far_larger_than_the_target_does_not_make_the_search_large() -> None:
    pair = make_pair(9007, points=(3000, 3500))
    for factor in (0.2, 1.0, 5.0, 25.0, 1000.0):
        [search] = make_searches(pair.target, pair.source * factor, np.ones(1), 20).values()
        assert np.prod(search.grid.shape) < 80**3
        assert len(search.turns()) < 2 * np.pi * 3 * 20


def test_points_given_many_times_over_count_once() -> None:
    pair = make_pair(9008, overlap=(0.9, 1.0), points=(3000, 3500))
    many = np.concatenate([pair.source, np.tile(pair.source[:1], (2 * len(pair.source), 1))])
    for target, source in ((pair.target, many), (many, pair.target)):
        assert register_clouds(target, source).accepted


def test_a_free_scale_bridges_different_units() -> None:
    pair = make_pair(9007, overlap=(0.9, 1.0), points=(3000, 3500))
    result = register_clouds(pair.target, pair.source * 1000, scale="free")
    assert result.accepted, result.reasons
    assert result.scale == pytest.approx(1e-3, rel=0.01)


def test_the_alignment_nearest_to_the_surfaces_is_found_in_few_looks() -> None:
    pair = make_pair(9008, overlap=(0.9, 1.0), points=(3000, 3500))
    assert pair.T_target_source is not None
    rng = np.random.default_rng(0)
    target = prepare_cloud(pair.target, rng)
    alignments = [se3(np.eye(3), rng.normal(0, 0.4, 3)) @ pair.T_target_source for _ in range(90)]
    alignments.insert(37, pair.T_target_source)
    points = pair.source[:: len(pair.source) // 240]
    in_looks = best_fits(target, points, alignments, 0.2, keep=(30, 10, 1))
    assert in_looks[0] == 37 and sorted(in_looks) == list(range(91))
    fit = surface_fit(target, points, alignments, 0.2)
    at_once = best_fits(target, points, alignments, 0.2, keep=(91,))
    np.testing.assert_allclose(fit[at_once], np.sort(fit)[::-1], rtol=1e-9)


def test_not_a_number_rows_do_not_spoil_a_good_cloud() -> None:
    pair = make_pair(9008, overlap=(0.9, 1.0), points=(3000, 3500))
    source = np.concatenate([pair.source, np.full((20, 3), np.nan)])
    assert register_clouds(pair.target, source).accepted


def test_a_wrong_shape_is_an_error_of_the_caller() -> None:
    with pytest.raises(DataError, match="shape"):
        register_clouds(np.zeros((5, 2)), np.zeros((500, 3)))
