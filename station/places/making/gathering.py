"""Groups of what lies close together, at most so many of them: the places of a room that a person can tell apart."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, IntArray


def gather(p: FloatArray, at_most: int) -> list[IntArray]:
    """Groups of points (n, 3), `at_most` of them and none for no points; each in order, by their first members.

    The two groups whose farthest members are closest become one, again and again: what comes out is compact, however
    unevenly the points lie (complete linkage; Sørensen, Biologiske Skrifter 5(4), 1948).
    """
    groups = [[i] for i in range(len(p))]
    apart = np.linalg.norm(p[:, None] - p[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    while len(groups) > at_most:
        a, b = sorted(int(i) for i in np.unravel_index(int(apart.argmin()), apart.shape))
        apart[a] = apart[:, a] = np.maximum(apart[a], apart[b])
        apart[a, a] = np.inf
        apart = np.delete(np.delete(apart, b, axis=0), b, axis=1)
        groups[a] += groups.pop(b)
    return [np.sort(np.array(group, dtype=np.int64)) for group in groups]
