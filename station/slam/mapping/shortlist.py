"""Which older keyframes look like a new one; it grows with every keyframe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from station.slam.mapping.config import MatchConfig
from station.vision.features import Features, Float32Array, to_unit
from station.vision.matching import match_both_ways


class Shortlist:
    """Finds older keyframes that look alike, by matching the largest features only: no vocabulary is needed."""

    def __init__(self, config: MatchConfig, max_keyframes: int = 400) -> None:
        self._config = config
        self._max_keyframes = max_keyframes
        self._descriptors: list[Float32Array] = []

    def add(self, features: Features) -> None:
        self._descriptors.append(to_unit(features.descriptors[: self._config.shortlist_features]))

    def most_alike(self, query: Features, older: Sequence[int]) -> list[int]:
        """Among these keyframes: those that look most like the query, best first."""
        descriptors = to_unit(query.descriptors[: self._config.shortlist_features])
        if len(older) > self._max_keyframes:  # long drives: the work per keyframe stays bounded
            some = np.unique(np.linspace(0, len(older) - 1, self._max_keyframes).astype(int))
            older = [older[k] for k in some.tolist()]
        scores = []
        for k in older:
            pairs = match_both_ways(descriptors @ self._descriptors[k].T, self._config.max_ratio)
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
