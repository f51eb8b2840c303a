"""Feature tracks: who saw the same point, from pairwise matches; and where the point is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from shared.geometry import IntArray

Pairs = tuple[int, int, IntArray]  # keyframe a, keyframe b, (M, 2) features of a and b


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Observations sorted by keyframe, then point: row i says keyframe[i] sees point[i] as feature[i]."""

    keyframe: IntArray  # (K,)
    point: IntArray  # (K,)
    feature: IntArray  # (K,)
    num_points: int

    def only(self, keep: npt.NDArray[np.bool_], min_length: int = 2) -> Tracks:
        """The kept observations; points seen by fewer than min_length of them are dropped and the rest renumbered."""
        counts = np.bincount(self.point[keep], minlength=self.num_points)
        alive = counts >= min_length
        keep = keep & alive[self.point]
        number = np.cumsum(alive) - 1
        return Tracks(self.keyframe[keep], number[self.point[keep]], self.feature[keep], int(alive.sum()))

    def alive(self, keep: npt.NDArray[np.bool_], min_length: int = 2) -> npt.NDArray[np.bool_]:
        """(num_points,) which points `only` would keep."""
        return np.bincount(self.point[keep], minlength=self.num_points) >= min_length


def build_tracks(num_features: Sequence[int], matches: Iterable[Pairs]) -> Tracks:
    """Connected features become tracks; what a track sees twice in one keyframe is a contradiction and dropped."""
    offset = np.concatenate([[0], np.cumsum(num_features)]).astype(np.int64)
    left, right = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for a, b, pairs in matches:
        left.append(offset[a] + pairs[:, 0])
        right.append(offset[b] + pairs[:, 1])
    i, j = np.concatenate(left), np.concatenate(right)
    total = int(offset[-1])
    graph = coo_matrix((np.ones(len(i), np.int8), (i, j)), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    used = np.unique(np.concatenate([i, j]))
    keyframe = np.searchsorted(offset, used, side="right") - 1
    feature = used - offset[keyframe]
    _, point = np.unique(label[used], return_inverse=True)
    # Twice in one keyframe: one of the two is wrong, nobody knows which.
    key = keyframe * (int(point.max()) + 1 if len(point) else 1) + point
    _, inverse_index, counts = np.unique(key, return_inverse=True, return_counts=True)
    once = counts[inverse_index] == 1
    order = np.lexsort((point, keyframe))
    tracks = Tracks(keyframe[order], point[order], feature[order], int(point.max()) + 1 if len(point) else 0)
    return tracks.only(once[order])


def longest(tracks: Tracks, per_keyframe: int) -> npt.NDArray[np.bool_]:
    """(num_points,) the points that give every keyframe about per_keyframe observations, the longest tracks first.

    Bundle adjustment needs no more to place the poses; the other points are triangulated from them afterwards.
    """
    length = np.bincount(tracks.point, minlength=tracks.num_points)
    keyframe = tracks.keyframe[np.argsort(tracks.point, kind="stable")].tolist()
    begin = np.concatenate([[0], np.cumsum(length)]).tolist()
    have = [0] * (max(keyframe, default=-1) + 1)
    chosen = np.zeros(tracks.num_points, dtype=bool)
    for m in np.argsort(-length, kind="stable").tolist():
        seen_from = keyframe[begin[m] : begin[m + 1]]
        if min([have[k] for k in seen_from], default=per_keyframe) < per_keyframe:
            chosen[m] = True
            for k in seen_from:
                have[k] += 1
    return chosen
