"""Allan deviation of a resting sensor, for the eye: what is reported is fitted to the spectrum (noise_fit.py)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from shared.geometry import FloatArray

POINTS = 60  # averaging times, evenly on a log scale
LONGEST_SHARE = 0.2  # of a stretch: beyond it there are too few independent differences to show


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Overlapping Allan deviation over averaging time, with its 95 % interval."""

    tau_s: FloatArray  # (n,)
    deviation: FloatArray  # (n,) the signal's unit
    low: FloatArray  # (n,)
    high: FloatArray  # (n,)


def allan_deviation(stretches: Sequence[FloatArray], rate_hz: float) -> AllanCurve:
    """Of one or more axes or stretches (n_i,) together; the longest one settles how far the curve goes.

    The interval's degrees of freedom are those of a random walk, which are the fewest of the three kinds of noise.
    Source: Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, sections 5.2.4 and 5.4.1.
    """
    integrals = [np.concatenate([[0.0], np.cumsum(values - values.mean())]) / rate_hz for values in stretches]
    longest = max(map(len, integrals))
    sizes = np.unique(np.round(np.geomspace(1, max(1, LONGEST_SHARE * longest), POINTS)).astype(int))
    rows = [_at(integrals, int(m), rate_hz) for m in sizes]
    tau, variance, dof = np.array(rows).T
    tail = 0.025
    low, high = (np.sqrt(variance * dof / chdtri(dof, p)) for p in (tail, 1.0 - tail))
    return AllanCurve(tau, np.sqrt(variance), low, high)


def _at(integrals: Sequence[FloatArray], m: int, rate_hz: float) -> tuple[float, float, float]:
    """Averaging time, variance and degrees of freedom for averages of m samples."""
    tau = m / rate_hz
    total, count, dof = 0.0, 0, 0.0
    for x in integrals:
        if len(x) <= 2 * m:
            continue
        second = x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]
        total += float(second @ second)
        count += len(second)
        dof += _walk_dof(len(x), m)
    return tau, total / (2.0 * tau**2 * count), max(1.0, dof)


def _walk_dof(n: int, m: int) -> float:
    """Equivalent degrees of freedom where a random walk prevails. NIST SP 1065, table 5."""
    if n < 4:
        return 1.0
    return (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / (n - 3) ** 2
