"""One active map with what is asked of it for every image and answer: its places' tree, its unit, what it saw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from shared.geometry import FloatArray
from station.model.place_answer import Localization
from station.model.place_map import PlaceMap
from station.places.making.scale import ground_rotation, units_per_metre
from station.places.space.space import Space
from station.places.space.widened import WidenedSpace
from station.places.tracking.floor import Floor
from station.places.tracking.room_view import RoomView
from station.places.tracking.sightings import Sightings


@dataclass(frozen=True, slots=True, eq=False)
class MapView:
    place_map: PlaceMap
    centroids: FloatArray  # (P, 3)
    tree: cKDTree | None  # of the centroids; None without places
    unit: float  # map units per metre
    area_m2: float
    space: Space  # as the mapping navigation saw it: by it an image's evidence is judged
    reach: WidenedSpace  # and as recognised images saw it since: by it a pose that is believed
    floor: Floor | None
    sightings: Sightings
    rooms: RoomView | None  # None without rooms

    @classmethod
    def of(cls, place_map: PlaceMap) -> MapView:
        unit = units_per_metre(place_map.navigation)
        positions = place_map.navigation.keyframes.T_world_cam[:, :2, 3]
        size = np.ptp(positions, axis=0) / unit + 2.0 if len(positions) else np.array([2.0, 2.0])
        centroids = _centroids(place_map)
        space = Space.of(place_map.navigation).ending_at(_exits(place_map))
        return cls(
            place_map=place_map,
            centroids=centroids,
            tree=_tree(centroids),
            unit=unit,
            area_m2=float(np.prod(size)),
            space=space,
            reach=WidenedSpace.of(space),
            floor=Floor.of(place_map.navigation),
            sightings=Sightings(place_map, unit, space),
            rooms=RoomView.of(place_map.plan),
        )

    def regrouped(self, place_map: PlaceMap) -> MapView:
        """The same map with other places, rooms or names."""
        centroids = _centroids(place_map)
        rooms = RoomView.of(place_map.plan)
        view = replace(self, place_map=place_map, centroids=centroids, tree=_tree(centroids), rooms=rooms)
        exits, before = _exits(place_map), _exits(self.place_map)
        if len(exits) == len(before) and all(map(np.array_equal, exits, before)):
            return view
        space = self.space.ending_at(exits)
        sightings = Sightings(place_map, self.unit, space)
        return replace(view, space=space, reach=WidenedSpace.of(space), sightings=sightings)

    def looking(self, z: Localization) -> MapView:
        """The same map, which reaches farther by what a recognised image saw through."""
        p_seen = self.place_map.navigation.landmarks.p_world[z.landmarks]
        reach = self.reach.looking(z.T_map_cam[:3, 3], p_seen)
        return self if reach is self.reach else replace(self, reach=reach)

    def nearest(self, p_map: FloatArray, tie: float) -> tuple[FloatArray, FloatArray]:
        """Shares of points (n, 3) that each place is the nearest one to, and near within `tie` times that; (P,), (P,).

        In a map of thousands of places, distances to all of them would cost most of an answer.
        """
        count = len(self.centroids)
        if self.tree is None:
            return np.zeros(0), np.zeros(0)
        distance, index = self.tree.query(p_map)
        tied = self.tree.query_ball_point(p_map, tie * distance)
        # Rounding must not leave out the nearest one itself.
        point = np.repeat(np.arange(len(p_map)), [len(near) for near in tied])
        pairs = np.concatenate(
            [point * count + np.concatenate(tied).astype(np.int64), np.arange(len(p_map)) * count + index]
        )
        shares = np.bincount(index, minlength=count), np.bincount(np.unique(pairs) % count, minlength=count)
        return shares[0] / len(p_map), shares[1] / len(p_map)


def _exits(place_map: PlaceMap) -> list[FloatArray]:
    """(2, 2) each, on the ground of its navigation's space: doors that nobody went through."""
    if place_map.plan is None:
        return []
    R = ground_rotation(place_map.navigation) @ place_map.plan.R_ground_map.T
    doors = [np.pad(door.ends, ((0, 0), (0, 1))) for door in place_map.plan.doors if door.rooms[1] is None]
    return [(ends @ R.T)[:, :2] for ends in doors]


def _centroids(place_map: PlaceMap) -> FloatArray:
    """(P, 3) of its places."""
    return np.array([p.centroid_map for p in place_map.places], dtype=np.float64).reshape(-1, 3)


def _tree(centroids: FloatArray) -> cKDTree | None:
    return cKDTree(centroids) if len(centroids) else None
