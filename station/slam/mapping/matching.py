"""Features of keyframes, whoever finds them (sfm/colmap.py, ukf/map/views.py), and which keyframes see the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.slam.mapping.config import MatchConfig

Descriptors = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    uv_px: FloatArray  # (N, 2) as seen: distorted pixels
    sift: npt.NDArray[np.uint8]  # (N, 128) RootSIFT of any length: a quarter of what unit vectors take

    def __len__(self) -> int:
        return len(self.uv_px)

    @property
    def descriptors(self) -> Descriptors:
        """(N, 128) of length 1; made anew each time."""
        found = self.sift.astype(np.float32)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)


def match_descriptors(a: Descriptors, b: Descriptors, max_ratio: float) -> IntArray:
    """Pairs (M, 2) of descriptors that are each other's nearest, and clearly nearer than the second nearest.

    Source: Lowe, IJCV 60(2), 2004, section 7.1 (ratio test), both ways.
    """
    if len(a) < 2 or len(b) < 2:
        return np.empty((0, 2), dtype=np.int64)
    similarity = a @ b.T
    every = np.arange(len(a))
    best = similarity.argmax(axis=1)
    first = similarity[every, best]
    similarity[every, best] = -1.0  # twice a maximum is five times as fast as a partition
    second = similarity.max(axis=1)
    similarity[every, best] = first
    rows = np.flatnonzero(_is_clear(first, second, max_ratio))
    columns = best[rows]
    # The other way round is asked of these only: between images far apart they are few.
    first, of_columns = first[rows], similarity[:, columns]
    is_mutual = first == of_columns.max(axis=0)
    of_columns[rows, np.arange(len(rows))] = -1.0
    good = is_mutual & _is_clear(first, of_columns.max(axis=0), max_ratio)
    return np.column_stack([rows[good], columns[good]]).astype(np.int64)


def _is_clear(first: npt.NDArray[np.float32], second: npt.NDArray[np.float32], max_ratio: float) -> BoolArray:
    """Whether the nearest is clearly nearer than the second; of unit vectors, distance^2 = 2 - 2 * similarity."""
    return (1.0 - first) < max_ratio**2 * (1.0 - second)


class Shortlist:
    """Finds older keyframes that look alike, by matching the largest features only: no vocabulary is needed."""

    def __init__(self, config: MatchConfig, max_keyframes: int = 400) -> None:
        self._config = config
        self._max_keyframes = max_keyframes
        self._descriptors: list[Descriptors] = []

    def add(self, features: Features) -> None:
        self._descriptors.append(features.descriptors[: self._config.shortlist_features])

    def most_alike(self, query: Features, num_older: int) -> list[int]:
        """Among the first num_older keyframes: those that look most like the query, best first."""
        descriptors = query.descriptors[: self._config.shortlist_features]
        candidates = range(num_older)
        if num_older > self._max_keyframes:  # long drives: the work per keyframe stays bounded
            candidates = np.unique(np.linspace(0, num_older - 1, self._max_keyframes).astype(int)).tolist()
        scores = []
        for k in candidates:
            pairs = match_descriptors(descriptors, self._descriptors[k], self._config.max_ratio)
            scores.append((len(pairs), k))
        scores.sort(key=lambda score: (-score[0], score[1]))
        chosen: list[int] = []
        for count, k in scores:
            if count < self._config.min_shortlist_matches or len(chosen) == self._config.num_shortlist:
                break
            # Neighbours of a chosen one tell little that is new.
            if all(abs(k - other) > 1 for other in chosen):
                chosen.append(k)
        return chosen
