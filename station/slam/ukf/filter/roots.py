"""Square roots S of covariances P = S S^T that stay lower triangular (docs/slam.md, sec. 4).

Any S Q with orthogonal Q is a root of the same P. The filter only leaves rows out, repeats rows and appends columns, so
most of a root is triangular already and a few columns are left over; those alone are rotated in, for a fifth of what
starting from nothing costs. A root may have zeros on its diagonal (cloned poses repeat rows).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import blas, lapack

from shared.geometry import FloatArray, IntArray

PANEL = 16  # columns that LAPACK takes at once; the fastest of 1 to 64 for 200 rows


def triangular(S: FloatArray) -> FloatArray:
    """Lower-triangular root (n, n) of S S^T, by QR: the covariance itself is never formed."""
    return np.ascontiguousarray(np.asarray(np.linalg.qr(S.T, mode="r")).T)


def shrink(S: FloatArray) -> FloatArray:
    """Lower-triangular root (n, n) of S S^T, S (n, k), that leaves alone what is triangular already."""
    n = len(S)
    column, leftover = _pivots(S)
    if len(leftover) > n // 2:
        return triangular(S)
    L = np.zeros((n, n))
    has_column = column >= 0
    L[:, has_column] = S[:, column[has_column]]
    if not len(leftover):
        return L
    rest = np.asfortranarray(S[:, leftover].T)
    R, _, _, _ = lapack.dtpqrt(0, min(PANEL, n), L.T, rest, overwrite_a=1, overwrite_b=1)
    return np.ascontiguousarray(np.tril(R.T))


def _pivots(S: FloatArray) -> tuple[IntArray, IntArray]:
    """For each row a column (n,) that is zero above it, or -1; and the columns that no row took.

    From the last row upwards, each takes the column that begins lowest: then as few as possible are left over.
    """
    filled = S != 0.0
    first = np.where(filled.any(axis=0), np.argmax(filled, axis=0), -1)
    order = np.argsort(-first, kind="stable")
    order = order[first[order] >= 0]
    begins = first[order].tolist()
    column = np.full(len(S), -1, dtype=np.int64)
    taken = 0
    for row in range(len(S) - 1, -1, -1):
        if taken < len(begins) and begins[taken] >= row:
            column[row] = order[taken]
            taken += 1
    return column, order[taken:]


class InformationRoot:
    """M = I + A^T A (k, k), factored as C C^T with upper-triangular C, so that S C^-T is triangular where S is.

    M's eigenvalues are at least 1: the factor exists whatever the measurements, as long as they are finite.
    """

    def __init__(self, A: FloatArray) -> None:
        M = A.T @ A
        M[np.diag_indices_from(M)] += 1.0
        # LAPACK's factor is lower triangular: of M with rows and columns in reverse order.
        self._factor, failed = lapack.dpotrf(np.ascontiguousarray(M[::-1, ::-1]).T, lower=1, overwrite_a=1)
        if failed:  # only where A overflowed; the state becomes NaN, and tracking is given up for that
            self._factor = np.full_like(self._factor, np.nan)

    def solve(self, b: FloatArray) -> FloatArray:
        """M^-1 b (k,)."""
        x, _ = lapack.dpotrs(self._factor, b[::-1], lower=1)
        return np.asarray(x[::-1])

    def divide(self, S: FloatArray) -> FloatArray:
        """S C^-T (n, k), a root of S M^-1 S^T."""
        reversed_t = np.array(S[:, ::-1], order="C").T
        divided = blas.dtrsm(1.0, self._factor, reversed_t, lower=1, overwrite_b=1)
        return np.ascontiguousarray(divided.T[:, ::-1])
