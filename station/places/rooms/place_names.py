"""Places get the names of their rooms: "Kitchen · 2" says more than "Place 17"."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from station.model.floor_plan import FloorPlan
from station.model.place_map import DOOR_TO, ROOM_SEPARATOR, Place
from station.places.making.names import DOOR_SIDE, NAME_PREFIX, name_in_room

DOOR_SIDE_M = 1.2  # from a door's middle to the place's: what one touches while passing


def named_by_rooms(places: Sequence[Place], plan: FloorPlan) -> tuple[Place, ...]:
    """The places, those that no person named called after their rooms; the same for the same plan and numbers.

    A place keeps its number while it stays in its room, whatever the room is called; a place of no room is "Place 5".
    """
    used = {place.name.casefold() for place in places if place.named}
    renamed = {}
    for room_id, room_name in [*((room.id, room.name) for room in plan.rooms), (None, None)]:
        unnamed = [p for p in places if not p.named and plan.room_of_place.get(p.id) == room_id]
        if room_id is not None and room_name is not None:
            for place_id, word in _at_doors(places, plan, room_id):
                name = name_in_room(room_name, word)
                if place_id in {place.id for place in unnamed} and name.casefold() not in used:
                    renamed[place_id] = name
                    used.add(name.casefold())
        for place, number in _numbered([place for place in unnamed if place.id not in renamed]):
            while (name := _called(room_name, number)).casefold() in used:
                number += 1
            renamed[place.id] = name
            used.add(name.casefold())
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


def _at_doors(places: Sequence[Place], plan: FloorPlan, room_id: str) -> Iterator[tuple[str, str]]:
    """Ids of places of a room that one door is beside, each with a word: of its only door, or of where the door leads.

    A door is beside the place of the room that is the nearest to it, so that who stands there is at that place.
    """
    inside = [place for place in places if plan.room_of_place.get(place.id) == room_id and not place.hidden]
    doors = [door for door in plan.doors if room_id in door.rooms]
    if len(inside) < 2 or not doors:  # one place is the whole room
        return
    name = {room.id: room.name for room in plan.rooms}
    ground = np.array([(plan.R_ground_map @ place.centroid_map)[:2] for place in inside])
    away = np.linalg.norm(ground[:, None] - [door.ends.mean(axis=0) for door in doors], axis=2)
    nearest = away.argmin(axis=0)
    for k, door in enumerate(doors):
        place = inside[nearest[k]]
        other = door.rooms[1] if door.rooms[0] == room_id else door.rooms[0]
        is_beside = away[nearest[k], k] < max(DOOR_SIDE_M * plan.unit, place.radius)
        if is_beside and np.count_nonzero(nearest == nearest[k]) == 1:
            if len(doors) == 1:
                yield place.id, DOOR_SIDE
            elif other is not None:
                yield place.id, f"{DOOR_TO} {name[other]}"
