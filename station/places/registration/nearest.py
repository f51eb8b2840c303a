"""Nearest target points of points that move a little at a time: the tree is asked again only where that may matter.

From one step of a refinement to the next most points keep their nearest neighbour. One whose nearest and second
nearest differ by more than twice what it has moved since keeps it for certain, so nothing here is approximate.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.places.registration.cloud import PreparedCloud

MARGIN = 1.25  # of the radius looked in: a point with nothing there may move a quarter of it before it is asked again


class NearestTracker:
    """Nearest points of one target for one set of points, asked for at every step."""

    def __init__(self, target: PreparedCloud, count: int) -> None:
        self._target = target
        self._asked_at = np.zeros((count, 3))
        self._index = np.zeros(count, dtype=np.int64)
        self._nearest = np.zeros(count)  # distance when asked
        self._other = np.full(count, -np.inf)  # every other target point was farther than that when asked

    def find(self, moved: FloatArray, reach: float) -> tuple[IntArray, npt.NDArray[np.bool_]]:
        """Index of the nearest target point, and whether it is nearer than `reach`, for the points (m, 3) now."""
        step = moved - self._asked_at
        path = np.sqrt(np.einsum("ni,ni->n", step, step))
        # Without a point nearby, `nearest` is 0 and the index means nothing: none may have come into reach.
        lonely = self._index < 0
        stale = np.where(lonely, self._other - path <= reach, self._other - path <= self._nearest + path)
        if stale.any():
            self._ask(np.flatnonzero(stale), moved, reach)
        index = np.maximum(self._index, 0)
        gap = moved - self._target.points[index]
        return index, (self._index >= 0) & (np.einsum("ni,ni->n", gap, gap) < reach * reach)

    def _ask(self, stale: IntArray, moved: FloatArray, reach: float) -> None:
        limit = MARGIN * reach
        distance, index = self._target.tree.query(moved[stale], k=2, distance_upper_bound=limit)
        found = np.isfinite(distance[:, 0])
        self._asked_at[stale] = moved[stale]
        self._index[stale] = np.where(found, index[:, 0], -1)
        self._nearest[stale] = np.where(found, distance[:, 0], 0.0)
        self._other[stale] = np.where(found, np.minimum(distance[:, 1], limit), limit)
