"""Which room something on a wall hangs in: the one that it was seen from a little before it."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.model.floor_plan import NO_ROOM, FloorPlan

OFF_WALL_M, REACH_M = 0.1, 0.2  # a sticker's room is asked for between these distances before it
STEPS = 8


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
