"""The walls of a rectangular room: four sides with door openings, what is seen of them, what stops a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from robot.simulation.building import DOOR_HEIGHT_M, Builder
from robot.simulation.textures import TextureSpec
from robot.simulation.world import WALL_HEIGHT_M, WALL_THICKNESS_M, Door, Obstacle, Room

_HALF_WALL = WALL_THICKNESS_M / 2


@dataclass(frozen=True, slots=True)
class WallRun:
    """One side of one room: from `left` to `right` as seen from inside."""

    left: tuple[float, float]
    right: tuple[float, float]
    length_m: float
    openings: tuple[tuple[float, float], ...]  # m along the wall

    @property
    def yaw_rad(self) -> float:
        """Direction of a piece's local x axis: its y axis then looks into the room."""
        return math.atan2(self.left[1] - self.right[1], self.left[0] - self.right[0])

    def at(self, s_m: float) -> tuple[float, float]:
        f = s_m / self.length_m
        return (self.left[0] + f * (self.right[0] - self.left[0]), self.left[1] + f * (self.right[1] - self.left[1]))


def wall_runs(room: Room, index: int, doors: Sequence[Door]) -> list[WallRun]:
    """The four walls as seen from inside: south, east, north, west."""
    x0, y0, x1, y1 = room.x0_m, room.y0_m, room.x1_m, room.y1_m
    # Seen from inside, the left end of the south wall (y0) is at x1.
    ends = [((x1, y0), (x0, y0)), ((x1, y1), (x1, y0)), ((x0, y1), (x1, y1)), ((x0, y0), (x0, y1))]
    runs = []
    for left, right in ends:
        length = math.hypot(right[0] - left[0], right[1] - left[1])
        direction = ((right[0] - left[0]) / length, (right[1] - left[1]) / length)
        openings = []
        for door in doors:
            if index not in door.rooms:
                continue
            s = (door.x_m - left[0]) * direction[0] + (door.y_m - left[1]) * direction[1]
            off = abs(-(door.x_m - left[0]) * direction[1] + (door.y_m - left[1]) * direction[0])
            if off < WALL_THICKNESS_M and 0 < s < length:
                openings.append((s - door.width_m / 2, s + door.width_m / 2))
        runs.append(WallRun(left, right, length, tuple(sorted(openings))))
    return runs


def build_wall(
    builder: Builder,
    run: WallRun,
    texture: TextureSpec,
    room: int,
    wall_height_m: float = WALL_HEIGHT_M,
    door_height_m: float = DOOR_HEIGHT_M,
) -> None:
    """A wall with its door openings cut out."""
    s = 0.0
    for low, high in [*run.openings, (run.length_m, run.length_m)]:
        builder.upright(run.at(s), run.at(low), (0.0, wall_height_m), texture, room, (s, 0.0))
        if high > low:
            builder.upright(run.at(low), run.at(high), (door_height_m, wall_height_m), texture, room, (low, 0.0))
        s = high


def wall_obstacles(room: Room, index: int, doors: Sequence[Door]) -> list[Obstacle]:
    """The solid parts of a room's four walls."""
    return [box for run in wall_runs(room, index, doors) for box in wall_boxes(run, index)]


def wall_boxes(run: WallRun, room: int) -> list[Obstacle]:
    """Half a wall's thickness per room, so that nothing sticks into the neighbouring room."""
    boxes = []
    s = -_HALF_WALL
    outward = math.sin(run.yaw_rad), -math.cos(run.yaw_rad)
    for low, high in [*run.openings, (run.length_m + _HALF_WALL, 0.0)]:
        if low - s > 1e-6:
            x, y = run.at((s + low) / 2)
            x, y = x + outward[0] * _HALF_WALL / 2, y + outward[1] * _HALF_WALL / 2
            boxes.append(Obstacle(x, y, (low - s) / 2, _HALF_WALL / 2, run.yaw_rad, WALL_HEIGHT_M, "wall", room))
        s = high
    return boxes
