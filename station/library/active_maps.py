"""The maps that robots are looked for in.

*The* active map is the first of them: places, graph and what is made of them are its own. The order of the others
means nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.bounded import shown
from station.errors import Conflict, Unknown
from station.model.floor_plan import Door, FloorPlan, Room
from station.model.place_map import Place, PlaceMap
from station.model.points import NO_PLACE
from station.places.making.colours import number_places


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class ActiveMap:
    """A map in use, and what is derived from it once."""

    place_map: PlaceMap
    place_of_point: npt.NDArray[np.uint8]  # (M,) number of its place, NO_PLACE for none
    numbers: Mapping[str, int]  # of the places, by id; also of some that are gone and may come back

    def place(self, place_id: str) -> Place:
        """Raises Unknown."""
        for place in self.place_map.places:
            if place.id == place_id:
                return place
        raise Unknown(f"the active map has no place {shown(place_id)}; GET /places lists them")

    def require_plan(self) -> FloorPlan:
        """Raises Conflict: it was made before there were plans, or of nothing that shows a floor."""
        if self.place_map.plan is None:
            raise Conflict(f"{self.place_map.name} has no floor plan; build it again with POST /maps")
        return self.place_map.plan

    @property
    def rooms(self) -> tuple[Room, ...]:
        return () if self.place_map.plan is None else self.place_map.plan.rooms

    def room(self, room_id: str) -> Room:
        """Raises Unknown."""
        for room in self.rooms:
            if room.id == room_id:
                return room
        raise Unknown(f"the active map has no room {shown(room_id)}; GET /rooms lists them")

    @property
    def doors(self) -> tuple[Door, ...]:
        return () if self.place_map.plan is None else self.place_map.plan.doors

    def door(self, door_id: str) -> Door:
        """Raises Unknown."""
        for door in self.doors:
            if door.id == door_id:
                return door
        raise Unknown(f"the active map has no door {shown(door_id)}; GET /floorplan lists them")

    @property
    def visible_places(self) -> tuple[Place, ...]:
        """Those that are not hidden: the graph's nodes."""
        return tuple(place for place in self.place_map.places if not place.hidden)


class ActiveMaps:
    """Those in use now. Choosing and changing them is the matter of `Maps`."""

    def __init__(self) -> None:
        self.all: tuple[ActiveMap, ...] = ()
        self.revision = 0  # counts what the first of them was, so that a page knows when to read it again

    @property
    def first(self) -> ActiveMap | None:
        return self.all[0] if self.all else None

    def require_first(self) -> ActiveMap:
        """Raises Conflict in words when no map is active."""
        if not self.all:
            raise Conflict("no map is active; build one with POST /maps and choose it with PUT /maps/active")
        return self.all[0]

    def find(self, map_id: str) -> ActiveMap | None:
        """The active map of this id."""
        return next((active for active in self.all if active.place_map.id == map_id), None)

    def use(self, maps: Sequence[ActiveMap]) -> None:
        """These from now on, the first one first."""
        self.all = tuple(maps)
        self.revision += 1

    def replace(self, place_map: PlaceMap) -> ActiveMap:
        """An active map has other places or names; places keep their numbers."""
        self.revision += 1
        before = self.find(place_map.id)
        changed = numbered(place_map, {} if before is None else before.numbers)
        self.all = tuple(changed if active is before else active for active in self.all)
        return changed


def numbered(place_map: PlaceMap, kept: Mapping[str, int]) -> ActiveMap:
    """A map with the numbers of its places; `kept`: those it had already."""
    numbers = number_places(place_map.places, place_map.edges, kept)
    place_of_point = np.full(len(place_map.navigation.landmarks), NO_PLACE, np.uint8)
    for place in place_map.places:
        if not place.hidden:
            place_of_point[place.landmark_index] = numbers.get(place.id, NO_PLACE)
    return ActiveMap(place_map, place_of_point, {**kept, **numbers})
