"""Noise density, bias instability and random walk by maximum likelihood, each with its interval.

A band's mean square is gamma distributed about the model of `spectrum.py`, so that the likelihood is known. Nothing is
read off slopes: where flicker bends the Allan deviation, a line of slope 1/2 through it is no random walk.
Sources: Whittle, Ark. Mat. 2, 1953 (the likelihood); IEEE Std 952 annex C (the noise terms); intervals are where the
likelihood ratio stays below the 95 % point of its chi-square distribution (Wilks, Ann. Math. Stat. 9, 1938).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, nnls
from scipy.special import chdtri

from shared.geometry import FloatArray
from station.calibration.imu.spectrum import Spectrum

CONFIDENCE = 0.95
LIMIT = 0.5 * float(chdtri(1, 1.0 - CONFIDENCE))  # of the log-likelihood below its maximum
# Flicker that is not there would be found in one recording of a hundred, and would take from the random walk.
FLICKER_LIMIT = 0.5 * float(chdtri(1, 0.01))
FLAT_SHARE = 2.0 * math.log(2.0) / math.pi  # of B^2: flicker's Allan variance, at every averaging time
MAX_ROUNDS = 100
SETTLED = 1e-9  # change of the log-likelihood that ends the rounds
PRECISION = 1e-4  # relative, of an interval's ends
FLICKER = 1  # of the design's columns: white noise, flicker, random walk


@dataclass(frozen=True, slots=True)
class Estimate:
    """One figure and its 95 % interval. `low` is 0 where the recording does not tell it from none at all."""

    value: float  # the most likely one, known or not
    low: float
    high: float

    @property
    def is_known(self) -> bool:
        """Whether the interval lies within a factor of two: of a wider one only the ends are told."""
        return self.high < 2.0 * self.low


@dataclass(frozen=True, slots=True)
class Noise:
    """What one axis, or three in the mean, adds to the truth."""

    density: Estimate  # N, unit / sqrt(Hz)
    instability: Estimate  # B, unit: the flat part of the Allan deviation is 0.664 B
    walk: Estimate  # K, unit / s / sqrt(Hz)

    def allan_variance(self, tau_s: FloatArray) -> FloatArray:
        """Expected Allan variance after averaging over tau_s, unit squared. IEEE Std 952 annex C."""
        N, B, K = self.density.value, self.instability.value, self.walk.value
        return N**2 / tau_s + FLAT_SHARE * B**2 + K**2 * tau_s / 3.0


def most_likely(spectrum: Spectrum) -> FloatArray:
    """(3,) The weights of the design's columns, without intervals."""
    return _Likelihood(spectrum).maximum({}).theta


def fit_noise(spectrum: Spectrum) -> Noise:
    """The most likely noise, of all that a spectrum allows.

    Flicker and a random walk differ only where both are seen well. The figures are those of the plainer model, without
    flicker, where the recording does not contradict it; the intervals then hold those of both models.
    """
    likelihood = _Likelihood(spectrum)
    best, plain = likelihood.maximum({}), likelihood.maximum({FLICKER: 0.0})
    is_plain = best.log - plain.log < FLICKER_LIMIT
    chosen = plain if is_plain else best
    rate = spectrum.rate_hz
    figures = []
    for i, scale in enumerate((1.0 / rate, 1.0, rate)):
        ends = [_interval(likelihood, best, i, {})]
        if is_plain:
            ends.append((0.0, 0.0) if i == FLICKER else _interval(likelihood, plain, i, {FLICKER: 0.0}))
        low, high = min(low for low, _ in ends), max(high for _, high in ends)
        figures.append(Estimate(*(math.sqrt(scale * x) for x in (chosen.theta[i], low, high))))
    return Noise(*figures)


@dataclass(frozen=True, slots=True, eq=False)
class _Maximum:
    theta: FloatArray  # (3,) weights of the design's columns: white, flicker, walk
    log: float  # log-likelihood, but for a constant


class _Likelihood:
    def __init__(self, spectrum: Spectrum) -> None:
        self._design, self._power, self._half = spectrum.design, spectrum.power, 0.5 * spectrum.dof

    def most(self, i: int) -> float:
        """The weight with which one column alone would explain all of some band."""
        return float(np.max(self._power / self._design[:, i]))

    def maximum(self, fixed: dict[int, float]) -> _Maximum:
        """The best weights that are not negative, some of them fixed.

        Fisher scoring: each round is a least-squares fit with the weights that the round before gives.
        """
        free = [i for i in range(3) if i not in fixed]
        given = np.zeros(len(self._power))
        theta = np.zeros(3)
        for i, value in fixed.items():
            theta[i] = value
            given = given + value * self._design[:, i]
        expected = self._power
        log = -np.inf
        for _ in range(MAX_ROUNDS):
            weight = np.sqrt(self._half) / expected
            A = self._design[:, free] * weight[:, None]
            size = np.linalg.norm(A, axis=0)
            candidate = theta.copy()
            candidate[free] = nnls(A / size, weight * (self._power - given))[0] / size
            candidate, expected, new = self._not_past(theta, candidate, log)
            theta, gain, log = candidate, new - log, new
            if gain < SETTLED:
                break
        return _Maximum(theta, log)

    def _not_past(self, old: FloatArray, new: FloatArray, log: float) -> tuple[FloatArray, FloatArray, float]:
        """The new weights, or nearer to the old ones where the whole step would make them less likely."""
        for _ in range(30):
            expected = self._design @ new
            if (expected > 0.0).all():
                better = self._log(expected)
                if better >= log:
                    return new, expected, better
            new = 0.5 * (old + new)
        return old, self._design @ old, log

    def _log(self, expected: FloatArray) -> float:
        ratio = self._power / expected
        return float(np.sum(self._half * (np.log(ratio) - ratio + 1.0)))


def _interval(likelihood: _Likelihood, best: _Maximum, i: int, fixed: dict[int, float]) -> tuple[float, float]:
    """Where the profile likelihood of weight i stays within LIMIT of the maximum, other weights fixed or free."""

    def excess(x: float) -> float:
        return best.log - likelihood.maximum({**fixed, i: x}).log - LIMIT

    inside = float(best.theta[i])
    low = 0.0 if excess(0.0) <= 0.0 else float(brentq(excess, 0.0, inside, xtol=PRECISION * inside))
    outside = max(2.0 * inside, PRECISION * likelihood.most(i))
    while excess(outside) < 0.0:
        outside *= 4.0
    return low, float(brentq(excess, inside, outside, xtol=PRECISION * outside))
