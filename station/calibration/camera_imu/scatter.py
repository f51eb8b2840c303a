"""Standard deviations that hold where residuals are alike: these do not average out.

What each measurement contributes to the estimate is summed over those that may be alike, and the sums' scatter counts
where it is larger than what independent noise says.
Source: Liang and Zeger, Biometrika 73(1), 1986 (the "sandwich").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from shared.geometry import FloatArray, IntArray


def summed_by(values: FloatArray, labels: IntArray) -> FloatArray:
    """(labels, f) of values (N, f)."""
    order = np.argsort(labels, kind="stable")
    found, begin = np.unique(labels[order], return_index=True)
    out = np.zeros((int(found[-1]) + 1, values.shape[1]))
    out[found] = np.add.reduceat(values[order], begin)
    return out


def few_know_little(count: int) -> float:
    """By how much a scatter of so few is to be widened: Student's distribution at three sigmas, and the lost mean."""
    dof = max(count - 1, 1)
    return float(special.stdtrit(dof, special.ndtr(3.0)) / 3.0 * np.sqrt(count / dof))


def widening(independent: FloatArray, alike: Sequence[FloatArray]) -> FloatArray:
    """(f,) by how much larger than independent noise says the standard deviations are; at least 1.

    Args:
        independent: (f, f) covariance from independent noise; 0 where something is not estimated.
        alike: (clusters, f) of each way to gather: what every cluster contributes to the estimate.
    """
    variance = np.diag(independent)
    scatter = np.max([few_know_little(len(sums)) ** 2 * (sums**2).sum(axis=0) for sums in alike], axis=0)
    ratio = np.ones_like(variance)
    np.divide(scatter, variance, out=ratio, where=variance > 0)
    return np.sqrt(np.maximum(ratio, 1.0))
