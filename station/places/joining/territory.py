"""Which place of a map a point of its frame belongs to."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import FloatArray, IntArray
from station.model.place_map import PlaceMap


class Territory:
    """Which place a point of the map's frame belongs to: that of the nearest landmark of a place."""

    def __init__(self, place_map: PlaceMap) -> None:
        p = place_map.navigation.landmarks.p_world
        self._owner = np.repeat(
            np.arange(len(place_map.places)), [len(place.landmark_index) for place in place_map.places]
        )
        self._tree = cKDTree(np.concatenate([p[place.landmark_index] for place in place_map.places]))
        self._reach = float(np.median([place.radius for place in place_map.places]))

    def place_of(self, p_map: FloatArray) -> IntArray:
        """(n,) index of the place; -1 farther than a typical radius from every place's landmarks."""
        distance, index = self._tree.query(p_map)
        return np.where(distance <= self._reach, self._owner[index], -1).astype(np.int64)
