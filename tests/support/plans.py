"""A floor plan of two rooms, made by hand: for everything that only reads plans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from station.model.floor_plan import FREE, NO_ROOM, OCCUPIED, UNSEEN, Door, FloorPlan, Room
from station.model.place_map import PlaceMap

CELL = 0.1
WALL_X = (
    3.0  # between the living room (x -1..3) and the kitchen (x 3..7), y -1.5..1.5 both; the door is at y -0.45..0.45
)


def two_rooms(unit: float = 1.0) -> FloorPlan:
    """In a map of `unit` map units per metre; beyond a second door of the kitchen, at x = 7, nobody went."""
    state = np.full((100, 50), UNSEEN, dtype=np.uint8)  # from (-1.5, -2.5) on
    state[4:87, 9:41] = OCCUPIED
    state[5:85, 10:40] = FREE
    room = np.full(state.shape, NO_ROOM, dtype=np.int16)
    room[5:45, 10:40], room[45:85, 10:40] = 0, 1
    for walled in (slice(10, 20), slice(30, 40)):
        state[45, walled], room[45, walled] = OCCUPIED, NO_ROOM
    state[85:87, 20:30] = FREE  # the second door, and what was seen behind it
    state[87:97, 10:40] = FREE
    corners = np.array([[-1.0, -1.5], [7.0, -1.5], [7.0, 1.5], [-1.0, 1.5]])
    partition = np.array([[[3.0, -1.5], [3.0, -0.45]], [[3.0, 0.45], [3.0, 1.5]]])
    return FloorPlan(
        R_ground_map=np.eye(3),
        low=np.array([-1.5, -2.5]) * unit,
        cell=CELL * unit,
        unit=unit,
        state=state,
        room=room,
        rooms=(
            Room("room-l", "Living room", 12.0 * unit**2, np.array([1.0, 0.0]) * unit),
            Room("room-k", "Room 2", 12.0 * unit**2, np.array([5.0, 0.0]) * unit),
        ),
        doors=(
            Door("door-lk", ("room-l", "room-k"), np.array([[3.0, -0.45], [3.0, 0.45]]) * unit),
            Door("door-k", ("room-k", None), np.array([[7.0, -0.5], [7.0, 0.5]]) * unit),
        ),
        walls=np.concatenate([np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), partition]) * unit,
    )


def with_two_rooms(place_map: PlaceMap) -> PlaceMap:
    """The map with this plan; its places are in the rooms where their centroids lie."""
    plan = two_rooms()
    p = np.array([place.centroid_map for place in place_map.places]).reshape(-1, 3)
    numbers = zip(place_map.places, plan.rooms_at(p), strict=True)
    room_of_place = {place.id: plan.rooms[n].id for place, n in numbers if n != NO_ROOM}
    return replace(place_map, plan=replace(plan, room_of_place=room_of_place))
