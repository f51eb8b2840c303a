"""Whether the figures of a resting sensor's noise are those it was made with."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from station.calibration.imu.noise_fit import Estimate, Noise, fit_noise, most_likely
from station.calibration.imu.spectrum import pooled, spectrum_of
from tests.support.inertial_noise import ACCEL, FLICKERING_GYRO, GYRO, QUIET_GYRO, TrueNoise, axis

pytestmark = pytest.mark.computing
RATE = 50.0


@cache
def measured(seed: int, minutes: float, noise: TrueNoise) -> Noise:
    """Three axes in the mean."""
    rng = np.random.default_rng(seed)
    axes = [spectrum_of([axis(rng, int(60 * minutes * RATE), RATE, noise)], RATE, RATE / 10) for _ in range(3)]
    return fit_noise(pooled(axes, [one.design @ most_likely(one) for one in axes]))


@pytest.mark.parametrize("noise", [GYRO, FLICKERING_GYRO, QUIET_GYRO])
def test_white_noise_is_within_five_percent_from_two_minutes(noise: TrueNoise) -> None:
    errors = [measured(seed, 2.0, noise).density.value / noise.density - 1.0 for seed in range(20)]
    assert np.abs(errors).max() < 0.05


@pytest.mark.parametrize("noise", [GYRO, ACCEL])
def test_random_walk_is_within_twenty_percent_from_twenty_minutes_in_nine_of_ten(noise: TrueNoise) -> None:
    # Its spread is 8 to 10 %: of the random walk of three axes, 20 minutes hold only some 100 kicks.
    errors = [measured(seed, 20.0, noise).walk.value / noise.walk - 1.0 for seed in range(20)]
    assert np.sqrt(np.mean(np.square(errors))) < 0.13
    assert sum(abs(error) < 0.2 for error in errors) >= 18


@pytest.mark.parametrize("noise", [GYRO, ACCEL, FLICKERING_GYRO])
@pytest.mark.parametrize("minutes", [2.0, 20.0])
def test_intervals_hold_the_truth_as_often_as_they_say(noise: TrueNoise, minutes: float) -> None:
    found = [measured(seed, minutes, noise) for seed in range(30)]
    for name in ("density", "walk", "instability"):
        truth = getattr(noise, name)
        estimates: list[Estimate] = [getattr(one, name) for one in found]
        # Of 30 at 95 %: 24 or fewer in one of 300 trials.
        assert sum(one.low <= truth <= one.high for one in estimates) >= 25, name


def test_a_random_walk_that_flicker_hides_is_not_overstated() -> None:
    """A line of slope 1/2 through the Allan deviation at a few hundred seconds would say some 50 % too much."""
    hidden = TrueNoise(2.6e-4, 2e-5, 2e-4)
    values = [measured(seed, 20.0, hidden).walk for seed in range(20)]
    assert np.median([one.value for one in values]) < 1.25 * hidden.walk
    assert sum(one.low <= hidden.walk <= one.high for one in values) >= 17


def test_of_an_interval_wider_than_a_factor_of_two_only_the_ends_are_told() -> None:
    assert Estimate(1.0, 0.7, 1.3).is_known
    assert not Estimate(1.0, 0.4, 1.5).is_known
    assert not Estimate(1.0, 0.0, 1.1).is_known


def test_without_a_random_walk_only_a_limit_is_claimed() -> None:
    still = TrueNoise(2.6e-4, 0.0)
    walks = [measured(seed, 5.0, still).walk for seed in range(20)]
    assert sum(one.is_known for one in walks) <= 3
    assert all(one.high < 2e-5 for one in walks)


def test_stretches_apart_are_as_good_as_their_sum() -> None:
    """The jump between them, 50 times the noise, is not in the figures."""
    rng = np.random.default_rng(4)
    stretches = [axis(rng, 40_000, RATE, GYRO) + offset for offset in (0.0, 50 * GYRO.density * np.sqrt(RATE))]
    noise = fit_noise(spectrum_of(stretches, RATE, RATE / 10))
    assert noise.density.low < GYRO.density < noise.density.high
    assert noise.walk.low < GYRO.walk < noise.walk.high


def test_figures_scale_with_the_unit() -> None:
    values = axis(np.random.default_rng(1), 30_000, RATE, FLICKERING_GYRO)
    one, thousand = (fit_noise(spectrum_of([k * values], RATE, 10.0)) for k in (1.0, 1000.0))
    for a, b in ((one.density, thousand.density), (one.walk, thousand.walk), (one.instability, thousand.instability)):
        assert (b.value, b.low, b.high) == pytest.approx((1e3 * a.value, 1e3 * a.low, 1e3 * a.high), rel=1e-2)


def test_axes_of_unequal_noise_count_for_fewer() -> None:
    rng = np.random.default_rng(3)
    equal = [spectrum_of([axis(rng, 20_000, RATE, GYRO)], RATE, 10.0) for _ in range(3)]
    loud = [equal[0], equal[1], spectrum_of([axis(rng, 20_000, RATE, TrueNoise(2.6e-3, 2e-5))], RATE, 10.0)]
    same, other = (pooled(axes, [one.design @ most_likely(one) for one in axes]) for axes in (equal, loud))
    assert same.dof[-1] / equal[0].dof[-1] == pytest.approx(3.0, abs=0.1)
    assert other.dof[-1] / equal[0].dof[-1] == pytest.approx(1.0, abs=0.1)
