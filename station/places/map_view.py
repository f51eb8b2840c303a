"""One active map, as the estimator of the current place looks at it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray
from station.maps.map import PlaceMap
from station.places.coverage import Coverage, units_per_metre


@dataclass(frozen=True, slots=True, eq=False)
class MapView:
    """A map with what is asked of it for every answer."""

    place_map: PlaceMap
    centroids: FloatArray  # (P, 3)
    unit: float  # map units per metre
    area_m2: float
    coverage: Coverage

    @classmethod
    def of(cls, place_map: PlaceMap) -> MapView:
        """Prepare a map."""
        unit = units_per_metre(place_map)
        positions = place_map.navigation.keyframes.T_world_cam[:, :2, 3]
        size = np.ptp(positions, axis=0) / unit + 2.0 if len(positions) else np.array([2.0, 2.0])
        return cls(place_map, _centroids(place_map), unit, float(np.prod(size)), Coverage(place_map, unit))

    def regrouped(self, place_map: PlaceMap) -> MapView:
        """The same map with other places or names."""
        return replace(self, place_map=place_map, centroids=_centroids(place_map))


def _centroids(place_map: PlaceMap) -> FloatArray:
    """(P, 3) of its places."""
    return np.array([p.centroid_map for p in place_map.places], dtype=np.float64).reshape(-1, 3)
