"""What measured pixels differ by from the expected ones, all together: one Gaussian. Pure."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray


def diagonal_blocks(A: FloatArray, k: int) -> FloatArray:
    """The blocks (M, k, k) on the diagonal of A (M k, M k): a view."""
    M = len(A) // k
    return np.asarray(np.einsum("iaib->iab", A.reshape(M, k, M, k)))


def agreeing(nu: FloatArray, S: FloatArray, most: float) -> IntArray:
    """Which rows (K,) of the innovations nu (M, 2), with covariance S (2M, 2M), agree with each other.

    Where the others are known, one of them is off by (S^-1)_ii^-1 (S^-1 nu)_i, with covariance (S^-1)_ii^-1. While the
    chi-square of one exceeds `most`, the worst goes.
    Source: Neira and Tardos, IEEE T-RA 17(6), 2001, joint compatibility; with one candidate each there is no tree.
    """
    kept = np.arange(len(nu))
    while len(kept):
        two = (2 * kept[:, None] + np.arange(2)).ravel()
        information = np.asarray(np.linalg.inv(S[np.ix_(two, two)]), dtype=np.float64)
        left = (information @ nu[kept].ravel()).reshape(-1, 2)
        own = diagonal_blocks(information, 2)
        chi2 = np.einsum("mi,mij,mj->m", left, np.linalg.inv(own), left)
        worst = int(np.argmax(chi2))
        if chi2[worst] < most:
            break
        kept = np.delete(kept, worst)
    return kept
