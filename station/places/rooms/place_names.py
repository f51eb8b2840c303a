"""Places get the names of their rooms: "Kitchen · 2" says more than "Place 17"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from station.model.floor_plan import FloorPlan
from station.model.place_map import Place
from station.places.making.names import DOOR_SIDE, NAME_PREFIX, ROOM_SEPARATOR, name_in_room

DOOR_SIDE_M = 1.2  # from a door's middle to the place's: what one touches while passing


def named_by_rooms(places: Sequence[Place], plan: FloorPlan) -> tuple[Place, ...]:
    """The places, those that no person named called after their rooms; the same for the same plan and numbers.

    A place keeps its number while it stays in its room, whatever the room is called; a place of no room is "Place 5".
    """
    used = {place.name.casefold() for place in places if place.named}
    renamed = {}
    for room_id, room_name in [*((room.id, room.name) for room in plan.rooms), (None, None)]:
        unnamed = [p for p in places if not p.named and plan.room_of_place.get(p.id) == room_id]
        by_door = "" if room_name is None else name_in_room(room_name, DOOR_SIDE)
        is_free = by_door.casefold() not in used
        at_door = _at_the_only_door(unnamed, plan, room_id) if room_id is not None and is_free else None
        for place, number in _numbered([place for place in unnamed if place.id != at_door]):
            while (name := _called(room_name, number)).casefold() in used:
                number += 1
            renamed[place.id] = name
            used.add(name.casefold())
        if at_door is not None:
            renamed[at_door] = by_door
    return tuple(replace(place, name=renamed.get(place.id, place.name)) for place in places)


def _called(room_name: str | None, number: int) -> str:
    return f"{NAME_PREFIX}{number}" if room_name is None else name_in_room(room_name, number)


def _numbered(places: Sequence[Place]) -> list[tuple[Place, int]]:
    """Numbers from names like "Kitchen · 2" are kept, the first of two equal ones; the others get what is free."""
    kept: dict[int, str] = {}
    for place in places:
        _, separator, number = place.name.rpartition(ROOM_SEPARATOR)
        if separator and number.isdecimal():
            kept.setdefault(int(number), place.id)
    number_of = {place_id: number for number, place_id in kept.items()}
    free = (n for n in range(1, len(places) + len(kept) + 1) if n not in kept)
    return [(place, number_of[place.id] if place.id in number_of else next(free)) for place in places]


def _at_the_only_door(places: Sequence[Place], plan: FloorPlan, room_id: str) -> str | None:
    """Id of the place beside the room's door, where it has one door and one place is that near to it."""
    doors = [door for door in plan.doors if room_id in door.rooms]
    if len(doors) != 1 or not places:
        return None
    ground = np.array([(plan.R_ground_map @ place.centroid_map)[:2] for place in places])
    away = np.linalg.norm(ground - doors[0].ends.mean(axis=0), axis=1)
    near = np.flatnonzero(away < DOOR_SIDE_M * plan.unit)
    return places[int(near[0])].id if len(near) == 1 else None
