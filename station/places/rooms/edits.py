"""What a person makes of a map's rooms: names, doors drawn and erased, rooms that are one. Pure: a map in, one out.

A change is noted as an edit of the plan, and the plan is made anew with it: so it holds for every later plan, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shared.errors import DataError
from shared.geometry import FloatArray
from shared.text import look_of
from station.model.floor_plan import MAX_EDITS, NO_ROOM, Door, FloorPlan, PlanEdits, Room
from station.model.place_map import PlaceMap
from station.places.rooms.lengths import THICK_M
from station.places.rooms.planning import planned, with_plan

MIN_LINE_M = 0.2  # a shorter one is a click that slipped


def find_room(place_map: PlaceMap, room_id: str) -> Room:
    """Raises DataError."""
    for room in require_plan(place_map).rooms:
        if room.id == room_id:
            return room
    raise DataError(f'map "{place_map.name}" has no room with id "{room_id}"; GET /rooms lists them')


def require_plan(place_map: PlaceMap) -> FloorPlan:
    """Raises DataError: the map has no floor plan."""
    if place_map.plan is None:
        raise DataError(f'map "{place_map.name}" has no floor plan; build it again from its navigations')
    return place_map.plan


def with_room_renamed(place_map: PlaceMap, room_id: str, name: str) -> PlaceMap:
    """The map with one room named by a person. Names are unique in a map, upper and lower case being one.

    `name` is tidy already. Raises DataError.
    """
    plan = require_plan(place_map)
    find_room(place_map, room_id)
    look = look_of(name).casefold()
    if any(look_of(room.name).casefold() == look and room.id != room_id for room in plan.rooms):
        raise DataError(f'map "{place_map.name}" has another room named "{name}"; choose a different name')
    edits = replace(place_map.plan_edits, names={**place_map.plan_edits.names, room_id: name})
    rooms = tuple(replace(room, name=name) if room.id == room_id else room for room in plan.rooms)
    return with_plan(replace(place_map, plan_edits=edits), replace(plan, rooms=rooms))


def with_name_taken_back(place_map: PlaceMap, room_id: str) -> PlaceMap:
    """The map with one room that no person named: it has the name of its number, or a free one.

    Raises DataError.
    """
    from station.places.rooms.identity import NAME_PREFIX  # SciPy, as in planning.py

    plan = require_plan(place_map)
    room = find_room(place_map, room_id)
    if room_id not in place_map.plan_edits.names:
        return place_map
    taken = {other.name.casefold() for other in plan.rooms if other is not room}
    own = plan.rooms.index(room) + 1
    names = (f"{NAME_PREFIX}{number}" for number in (own, *range(1, len(plan.rooms) + 1)))
    name = next(name for name in names if name.casefold() not in taken)
    kept = {id: name for id, name in place_map.plan_edits.names.items() if id != room_id}
    rooms = tuple(replace(other, name=name) if other is room else other for other in plan.rooms)
    edits = replace(place_map.plan_edits, names=kept)
    return with_plan(replace(place_map, plan_edits=edits), replace(plan, rooms=rooms))


def with_room_split(place_map: PlaceMap, line: FloatArray) -> PlaceMap:
    """The map with a door drawn along a line (2, 2) on the ground, which parts a room in two.

    Raises:
        DataError: the line is too short, or parts no room: of most lines the plan as it is tells so, at once.
    """
    plan, edits = require_plan(place_map), place_map.plan_edits
    if np.linalg.norm(line[1] - line[0]) < MIN_LINE_M * plan.unit:
        raise DataError("the line is too short for a door; draw it from wall to wall")
    if (why := why_useless(plan, line)) is not None:
        raise DataError(why)
    changed = _edited(place_map, replace(edits, doors_drawn=(*edits.doors_drawn, line)))
    made = require_plan(changed)
    is_door = any(door.is_drawn and np.array_equal(door.ends, line) for door in made.doors)
    if not is_door and len(made.rooms) <= len(plan.rooms):  # a plan by an older station may have had more rooms
        raise DataError("the line parts no room; draw it right across one, from wall to wall")
    return changed


def why_useless(plan: FloorPlan, line: FloatArray) -> str | None:
    """Why no room of a plan falls apart along a line (2, 2), for a person; None: one does."""
    from station.places.rooms.segments import DRAWN_M, line_cells, parted_along  # SciPy, as in planning.py

    cells = line_cells(line, plan.low, plan.cell, plan.unit, plan.room.shape)
    labels = plan.room.astype(np.int32) - NO_ROOM  # 0: no room
    parted = parted_along(labels, [cells])
    # What lies no farther beside the line than a wall is thick is no room: a door that was drawn twice cuts such off.
    near = line_cells(line, plan.low, plan.cell, plan.unit, plan.room.shape, 2 * THICK_M + DRAWN_M)
    was_cut = np.unique(labels[cells])
    rooms = [part for part in np.unique(parted[np.isin(labels, was_cut) & ~near & ~cells]) if part]
    if len(rooms) > np.count_nonzero(was_cut):
        return None
    if (door := _door_at(plan, line)) is not None:
        named = [room.name for room in plan.rooms if room.id in door.rooms]
        what = f"between {' and '.join(named)}" if len(named) == 2 else f"out of {named[0]}"
        return f"there is a door already, {what}; erase it first if it stands wrong"
    if not (labels[cells] > 0).any():
        return "the line parts no room, it lies outside of all of them; draw it right across one, from wall to wall"
    for xy in line:
        if (room_id := room_id_at(plan, xy)) is not None:
            [name] = [room.name for room in plan.rooms if room.id == room_id]
            return f"the line parts no room, it ends inside of {name}; draw it right across, from wall to wall"
    return "the line parts no room; draw it right across one, from wall to wall"


def _door_at(plan: FloorPlan, line: FloatArray) -> Door | None:
    """The door along which a line (2, 2) runs: the shorter one ends within a wall's thickness of the other."""
    from station.places.space.space import distance_to

    for door in plan.doors:
        short, long = sorted((door.ends, line), key=lambda ends: float(np.linalg.norm(ends[1] - ends[0])))
        if distance_to(long, short).max() <= THICK_M * plan.unit:
            return door
    return None


def with_door_erased(place_map: PlaceMap, door_id: str) -> PlaceMap:
    """The map without a door: what it led to is one room with where it led from; of two it keeps a name by a person.

    A door that nobody went through is noted to be none: the map goes on behind it as far as its cameras saw.

    Raises:
        DataError: there is no such door.
    """
    door = next((door for door in require_plan(place_map).doors if door.id == door_id), None)
    if door is None:
        raise DataError(f'map "{place_map.name}" has no door with id "{door_id}"; GET /floorplan lists them')
    if door.rooms[1] is None:
        return _edited(place_map, _without_door(place_map.plan_edits, door))
    both = sorted((door.rooms[0], door.rooms[1]), key=lambda room_id: room_id not in place_map.plan_edits.names)
    return with_rooms_merged(place_map, both, [door])


def with_rooms_merged(place_map: PlaceMap, room_ids: Sequence[str], doors: Sequence[Door] | None = None) -> PlaceMap:
    """The map with several rooms as one, which keeps id and name of the first, also in that part if it is split again.

    `doors` between them are erased, by default all that there are.

    Raises:
        DataError: there is no such room, fewer than two are named, or no doors lead from each to the others.
    """
    rooms = [find_room(place_map, room_id) for room_id in dict.fromkeys(room_ids)]
    if len(rooms) < 2:
        raise DataError("two different rooms are needed to make them one; GET /rooms lists them")
    ids = {room.id for room in rooms}
    between = [door for door in require_plan(place_map).doors if ids.issuperset(door.rooms)] if doors is None else doors
    edits = place_map.plan_edits
    for door in between:
        edits = _without_door(edits, door)
    gone = {room.id for room in rooms[1:]}
    edits = replace(
        edits,
        names={id: name for id, name in edits.names.items() if id not in gone},
        middles={rooms[0].id: rooms[0].middle} | {id: xy for id, xy in edits.middles.items() if id not in gone},
    )
    changed = _edited(place_map, edits)
    middles = np.array([room.middle for room in rooms])
    merged = {room_id_at(require_plan(changed), xy) for xy in middles}
    if len(merged) != 1 or None in merged:
        names = " and ".join(room.name for room in rooms)
        raise DataError(f"{names} cannot be one room: no door that could be erased leads from each to the others")
    return _renumbered(changed, str(merged.pop()), rooms[0])


def room_id_at(plan: FloorPlan, xy: FloatArray) -> str | None:
    """Id of the room at a position (2,) on the ground."""
    number = plan.rooms_at(np.append(xy, 0.0)[None] @ plan.R_ground_map)[0]
    return None if number == NO_ROOM else plan.rooms[number].id


def _edited(place_map: PlaceMap, edits: PlanEdits) -> PlaceMap:
    if len(edits.doors_drawn) + len(edits.doors_erased) > MAX_EDITS:
        raise DataError(f"a map keeps at most {MAX_EDITS} doors that people drew or erased; undo some")
    return planned(replace(place_map, plan_edits=edits))


def _without_door(edits: PlanEdits, door: Door) -> PlanEdits:
    """A door that a person drew is drawn no more; any other one is noted to be none."""
    if door.is_drawn and edits.doors_drawn:
        middle = door.ends.mean(axis=0)
        away = [float(np.linalg.norm(line.mean(axis=0) - middle)) for line in edits.doors_drawn]
        nearest = int(np.argmin(away))
        return replace(edits, doors_drawn=(*edits.doors_drawn[:nearest], *edits.doors_drawn[nearest + 1 :]))
    return replace(edits, doors_erased=(*edits.doors_erased, door.ends))


def _renumbered(place_map: PlaceMap, found: str, wanted: Room) -> PlaceMap:
    """The map whose room `found` has id and name of the wanted one."""
    plan = require_plan(place_map)

    called = {room.id: room.id for room in plan.rooms} | {found: wanted.id}
    suggestions = tuple(replace(s, room=called.get(s.room, s.room)) for s in place_map.suggestions)
    return with_plan(
        replace(place_map, suggestions=suggestions),
        replace(
            plan,
            rooms=tuple(replace(r, id=wanted.id, name=wanted.name) if r.id == found else r for r in plan.rooms),
            doors=tuple(
                replace(door, rooms=(called[a], None if b is None else called[b]))
                for door in plan.doors
                for a, b in [door.rooms]
            ),
            room_of_place={place: called[room] for place, room in plan.room_of_place.items()},
        ),
    )
