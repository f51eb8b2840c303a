"""Which descriptors of two sets show the same, by their similarity: a table (n, m) of dot products of unit vectors."""

from __future__ import annotations

import numpy as np

from shared.geometry import IntArray
from station.vision.features import Float32Array


def clearly_nearest(
    similarity: Float32Array, max_ratio: float, owner: IntArray | None = None
) -> tuple[IntArray, IntArray]:
    """Rows whose nearest column is clearly nearer than the second nearest, and that column: (k,), (k,).

    Args:
        max_ratio: of the distances to the nearest and to the second nearest.
        owner: (m,) what each column shows; of what the nearest one shows, no other column counts as second nearest.
    `similarity` is changed meanwhile, and is as before in the end: not one that others read.
    Source: Lowe, IJCV 60(2), 2004, section 7.1.
    """
    every = np.arange(len(similarity))
    best = similarity.argmax(axis=1)
    first = similarity[every, best]
    if owner is None:
        similarity[every, best] = -1.0  # twice a maximum is five times as fast as a partition
        second = similarity.max(axis=1)
        similarity[every, best] = first
    else:
        same = _columns_of(owner, owner[best])
        kept = similarity[same]
        similarity[same] = -1.0
        second = similarity.max(axis=1)
        similarity[same] = kept
    # Of unit vectors, distance^2 = 2 - 2 * similarity.
    rows = np.flatnonzero((1.0 - first) < max_ratio**2 * (1.0 - second))
    return rows, best[rows]


def _columns_of(owner: IntArray, wanted: IntArray) -> tuple[IntArray, IntArray]:
    """Of each row the columns that show what is wanted of it: row numbers (k,) and columns (k,)."""
    order = np.argsort(owner, kind="stable")
    begin = np.searchsorted(owner, wanted, side="left", sorter=order)
    length = np.searchsorted(owner, wanted, side="right", sorter=order) - begin
    at = np.repeat(begin - np.cumsum(length) + length, length) + np.arange(length.sum())
    return np.repeat(np.arange(len(wanted)), length), order[at]


def match_both_ways(similarity: Float32Array, max_ratio: float) -> IntArray:
    """Pairs (k, 2) of row and column, each clearly the other's nearest; none where one side has no second nearest."""
    if min(similarity.shape) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    rows, columns = clearly_nearest(similarity, max_ratio)
    # The other way round is asked of these columns only: between images far apart they are few.
    back, again = clearly_nearest(similarity.T[columns], max_ratio)
    good = rows[back] == again
    return np.column_stack([rows[back][good], columns[back][good]])
