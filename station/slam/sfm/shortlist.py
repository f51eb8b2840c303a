"""Which older keyframes look like a new one, where no odometry tells."""

from __future__ import annotations

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

    def most_alike(self, query: Features, num_older: int) -> list[int]:
        """Among the first num_older keyframes: those that look most like the query, best first."""
        descriptors = to_unit(query.descriptors[: self._config.shortlist_features])
        candidates = range(num_older)
        if num_older > self._max_keyframes:  # long drives: the work per keyframe stays bounded
            candidates = np.unique(np.linspace(0, num_older - 1, self._max_keyframes).astype(int)).tolist()
        scores = []
        for k in candidates:
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
