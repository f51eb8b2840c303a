"""How a resting sensor's noise is spread over frequency, in a form whose statistics are known exactly.

White noise and a random walk together are no stationary noise, but their first differences are, and the discrete sine
transform of the differences makes every coefficient independent of the others. With s = 2 sin(w / 2), w the angle per
sample, a coefficient's expected square is

    N^2 rate s^2  +  B^2 s  +  K^2 / rate        white noise, flicker (bias instability), random walk

exactly so for the first and the last (the covariance of the differences is tridiagonal and Toeplitz, which the sine
transform diagonalises), very nearly so for flicker. N, B and K are those of IEEE Std 952: two-sided densities N^2,
B^2 / (2 pi f) and K^2 / (2 pi f)^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dst

from shared.geometry import FloatArray

BANDS_PER_DECADE = 60  # a band is 4 % wide: the model is all but linear in it
MIN_SAMPLES = 4


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Mean squares of the sine transform's coefficients, in bands of frequency. Sorted by stretch, then frequency."""

    frequency_hz: FloatArray  # (n,) middle of the band
    dof: FloatArray  # (n,) coefficients in the band: degrees of freedom of its mean square
    power: FloatArray  # (n,) mean square of the coefficients of the differenced signal, its unit squared
    design: FloatArray  # (n, 3) mean of s^2, s and 1 over the band
    rate_hz: float

    def __len__(self) -> int:
        return len(self.power)

    def chosen(self, rows: FloatArray) -> Spectrum:
        """The bands that a mask or index names."""
        return Spectrum(self.frequency_hz[rows], self.dof[rows], self.power[rows], self.design[rows], self.rate_hz)


def spectrum_of(stretches: Sequence[FloatArray], rate_hz: float, max_hz: float) -> Spectrum:
    """The spectrum of one axis, from stretches (n_i,) without gaps, up to max_hz.

    What lies between two stretches, a bump or a gap, leaves no trace: each is differenced and transformed by itself.
    """
    parts = [_stretch(values, rate_hz, max_hz) for values in stretches if len(values) >= MIN_SAMPLES]
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return Spectrum(joined[0], joined[1], joined[2], joined[3], rate_hz)


def _stretch(
    values: FloatArray, rate_hz: float, max_hz: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    squares = dst(np.diff(values), type=1, norm="ortho") ** 2
    n = len(squares) + 1
    count = max(1, min(int(2 * n * max_hz / rate_hz), n - 1))
    k = np.arange(1, count + 1)
    s = 2.0 * np.sin(np.pi * k / (2 * n))
    bands = max(2, round(BANDS_PER_DECADE * np.log10(count + 1)))
    edges = np.unique(np.round(np.geomspace(1, count + 1, bands + 1)).astype(int)) - 1
    dof = np.diff(edges).astype(np.float64)

    def mean(x: FloatArray) -> FloatArray:
        return np.add.reduceat(x, edges[:-1]) / dof

    design = np.stack([mean(s * s), mean(s), np.ones(len(dof))], axis=1)
    return mean(k * rate_hz / (2 * n)), dof, mean(squares[:count]), design


def pooled(axes: Sequence[Spectrum], expected: Sequence[FloatArray]) -> Spectrum:
    """The mean spectrum of axes measured together; `expected` (n,) is the fitted mean square of each.

    Axes of unequal noise count for less than so many equal ones (Welch and Satterthwaite's degrees of freedom).
    """
    total = np.sum(expected, axis=0)
    first = axes[0]
    dof = first.dof * total**2 / np.sum(np.square(expected), axis=0)
    power = np.mean([axis.power for axis in axes], axis=0)
    return Spectrum(first.frequency_hz, dof, power, first.design, first.rate_hz)
