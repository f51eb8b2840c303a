"""The rooms of one active map, as a belief asks for them: in which room drawn positions are, or in which doorway."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from shared.geometry import FloatArray, IntArray
from station.model.floor_plan import FREE, NO_ROOM, FloorPlan

Numbers = npt.NDArray[np.int16]

DOORWAY_M = 0.5  # this near a door both of its rooms are right: a robot is half as long, a map as wrong
BESIDE_M = 0.3  # no robot is in a wall or a cupboard: what is drawn there counts to the room beside it
NO_DOOR = -1


@dataclass(frozen=True, slots=True, eq=False)
class RoomView:
    """A plan with its walls given to the rooms that they stand in, and its doorways."""

    plan: FloorPlan
    room: Numbers  # (X, Y) number of the room, or NO_ROOM
    door: Numbers  # (X, Y) number of the door between two rooms in whose doorway it is, or NO_DOOR
    rooms_of_door: IntArray  # (D, 2) numbers; NO_ROOM where nobody went through
    area: FloatArray  # (R,) of each room, square metres

    @classmethod
    def of(cls, plan: FloorPlan | None) -> RoomView | None:
        """None without a room."""
        if plan is None or not plan.rooms:
            return None
        number = {room.id: i for i, room in enumerate(plan.rooms)}
        rooms_of_door = np.array(
            [[NO_ROOM if id is None else number[id] for id in door.rooms] for door in plan.doors], dtype=np.int64
        ).reshape(-1, 2)
        room = _with_walls(plan)
        area = np.array([r.area for r in plan.rooms]) / plan.unit**2
        return cls(plan, room, _doorways(plan, room, rooms_of_door), rooms_of_door, area)

    def shares(self, p_map: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shares of positions (n, 3) in each room, and in it or in a doorway of it; (R,), (R,)."""
        count, cells = len(self.plan.rooms), self._cells(p_map)
        room, door = self.room[cells], self.door[cells]
        inside = np.bincount(room[room != NO_ROOM], minlength=count)
        tied = inside.copy()
        for number in np.unique(door[door != NO_DOOR]):
            a, b = self.rooms_of_door[number]
            here = room[door == number]
            tied[a] += np.count_nonzero(here != a)
            tied[b] += np.count_nonzero(here != b)
        return inside / len(p_map), tied / len(p_map)

    def door_between(self, a: int, b: int, p_map: FloatArray) -> str | None:
        """Id of the door between two rooms that is nearest to a position (3,)."""
        found = np.flatnonzero((np.sort(self.rooms_of_door, axis=1) == sorted((a, b))).all(axis=1))
        xy = (self.plan.R_ground_map @ p_map)[:2]
        nearest = min(
            found, key=lambda d: float(np.linalg.norm(self.plan.doors[d].ends.mean(axis=0) - xy)), default=None
        )
        return None if nearest is None else self.plan.doors[nearest].id

    def _cells(self, p_map: FloatArray) -> tuple[IntArray, ...]:
        """Indices of the cells of positions (n, 3); those beside the plan are at its border, which is in no room."""
        plan = self.plan
        index = np.floor(((p_map @ plan.R_ground_map.T)[:, :2] - plan.low) / plan.cell)
        return tuple(np.clip(index + 1, 0, np.array(self.room.shape) - 1).astype(np.int64).T)


def _with_walls(plan: FloorPlan) -> Numbers:
    """(X + 2, Y + 2) `plan.room` with a border of none, where cells that are not free count to the nearest room."""
    room = np.pad(plan.room, 1, constant_values=NO_ROOM)
    free = np.pad(plan.state == FREE, 1)
    distance, nearest = ndimage.distance_transform_edt(room == NO_ROOM, return_indices=True)
    beside = ~free & (distance <= BESIDE_M * plan.unit / plan.cell)
    beside[[0, -1], :] = beside[:, [0, -1]] = False
    return np.asarray(np.where(beside, room[tuple(nearest)], room), dtype=np.int16)


def _doorways(plan: FloorPlan, room: Numbers, rooms_of_door: IntArray) -> Numbers:
    """(X + 2, Y + 2) number of the nearest door between two rooms, within its reach and in one of the two."""
    door = np.full(room.shape, NO_DOOR, dtype=np.int16)
    nearest = np.full(room.shape, DOORWAY_M * plan.unit)
    for number, (ends, rooms) in enumerate(zip((d.ends for d in plan.doors), rooms_of_door, strict=True)):
        if NO_ROOM in rooms:
            continue
        begin, end = (
            np.clip((corner - plan.low) / plan.cell + 1 + side, 0, room.shape).astype(int)
            for corner, side in (
                (ends.min(axis=0) - DOORWAY_M * plan.unit, 0),
                (ends.max(axis=0) + DOORWAY_M * plan.unit, 1),
            )
        )
        window = slice(begin[0], end[0]), slice(begin[1], end[1])
        x, y = (plan.low[i] + (np.arange(begin[i], end[i]) - 0.5) * plan.cell for i in range(2))
        distance = _distance(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1), ends)
        nearer = (distance <= nearest[window]) & np.isin(room[window], rooms)
        nearest[window][nearer] = distance[nearer]
        door[window][nearer] = number
    return door


def _distance(p: FloatArray, ends: FloatArray) -> FloatArray:
    """Of points (…, 2) from a line segment (2, 2)."""
    along = ends[1] - ends[0]
    length2 = max(float(along @ along), 1e-12)
    t = np.clip((p - ends[0]) @ along / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - ends[0] - t[..., None] * along, axis=-1))
