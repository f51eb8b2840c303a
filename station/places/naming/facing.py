"""Which room something on a wall names: the one that it hangs in, or for a plate beside a door the one behind."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.model.floor_plan import NO_ROOM, Door, FloorPlan, SuggestionSource

OFF_WALL_M, REACH_M = 0.1, 0.2  # a sticker's room is asked for between these distances before it
STEPS = 8
PLATE_REACH_M = 0.5  # of a door: on its leaf, open or not, or on the wall within a hand or two of its jambs


def room_named(
    plan: FloorPlan, source: SuggestionSource, p_map: FloatArray, p_camera_map: FloatArray, sigma: float = 0.0
) -> int | None:
    """Number of the room that something at `p_map` (3,), seen from `p_camera_map`, names; None where that is open."""
    hangs_in = room_before(plan, p_map, p_camera_map, sigma)
    door = door_beside(plan, p_map) if source == "door plate" else None
    if door is None or hangs_in is None:
        return hangs_in
    here = plan.rooms[hangs_in].id
    if here not in door.rooms:
        return hangs_in
    behind = door.rooms[1] if door.rooms[0] == here else door.rooms[0]
    return next((n for n, room in enumerate(plan.rooms) if room.id == behind), None)  # None: nobody went through


def room_before(plan: FloorPlan, p_map: FloatArray, p_camera_map: FloatArray, sigma: float = 0.0) -> int | None:
    """Number of the room on whose side something at `p_map` (3,) hangs; None where its distance leaves that open.

    Rooms are asked for along the line of sight a little before it, as near and as far as its distance may be wrong (by
    `sigma`, map units): behind a thin wall is another room.
    """
    away = p_camera_map - p_map
    distance = float(np.linalg.norm(away))
    near, far = OFF_WALL_M * plan.unit, REACH_M * plan.unit + 2 * sigma
    steps = np.linspace(near, min(far, distance), STEPS)
    met = plan.rooms_at(p_map + steps[:, None] * (away / distance))
    rooms = set(met.tolist()) - {NO_ROOM}
    return rooms.pop() if len(rooms) == 1 else None


def door_beside(plan: FloorPlan, p_map: FloatArray) -> Door | None:
    """The nearest door that something at `p_map` (3,) may be the plate of."""
    xy = (plan.R_ground_map @ p_map)[:2]
    away = [_from_segment(xy, door.ends) for door in plan.doors]
    nearest = int(np.argmin(away)) if away else -1
    return plan.doors[nearest] if away and away[nearest] < PLATE_REACH_M * plan.unit else None


def _from_segment(xy: FloatArray, ends: FloatArray) -> float:
    """Distance of a point (2,) from a line segment (2, 2)."""
    along = ends[1] - ends[0]
    share = np.clip(((xy - ends[0]) @ along) / max(float(along @ along), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(xy - ends[0] - share * along))
