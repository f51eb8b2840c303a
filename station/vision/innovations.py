"""What measured pixels differ by from the expected ones, all together: one Gaussian. Pure."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from shared.geometry import FloatArray, IntArray


def diagonal_blocks(A: FloatArray, k: int) -> FloatArray:
    """The blocks (M, k, k) on the diagonal of A (M k, M k): a view."""
    M = len(A) // k
    return np.asarray(np.einsum("iaib->iab", A.reshape(M, k, M, k)))


def whitened(S: FloatArray, HP: FloatArray, nu: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """L of S = L L^T (2M, 2M), and what a Kalman update is made of: L^-1 H P (2M, n), L^-1 nu (2M,) of nu (M, 2)."""
    L = np.asarray(np.linalg.cholesky(S), dtype=np.float64)
    both = np.column_stack([HP, nu.ravel()])
    both = np.asarray(scipy.linalg.solve_triangular(L, both, lower=True, check_finite=False), dtype=np.float64)
    return L, both[:, :-1], both[:, -1]


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
