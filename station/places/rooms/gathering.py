"""A few places in each room instead of every cluster of landmarks: what a person can tell apart and name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from station.model.place_map import Place, PlaceMap
from station.places.making.changes import joined
from station.places.making.gathering import gather

AT_MOST = 6  # places of a room: its corners and its middle


def gathered(place_map: PlaceMap, room_of_place: Mapping[str, str]) -> PlaceMap:
    """The map with at most so many places in each room, and as many outside of all rooms.

    Neighbours of one room become one, with id and number of the largest. What a person named or hid stays as it is and
    counts; where that leaves nothing, what nobody named is one place more.
    """
    groups: list[list[Place]] = []
    shown = [place for place in place_map.places if not place.hidden]
    for room in dict.fromkeys(room_of_place.get(place.id) for place in shown):
        inside = [place for place in shown if room_of_place.get(place.id) == room]
        loose = [place for place in inside if not place.named]
        p = np.array([place.centroid_map for place in loose]).reshape(-1, 3)
        found = gather(p, max(AT_MOST - len(inside) + len(loose), 1))
        groups += [sorted((loose[i] for i in members), key=_size, reverse=True) for members in found]
    return joined(place_map, groups)


def _size(place: Place) -> int:
    return len(place.landmark_index)
