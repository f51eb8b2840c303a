"""What a simulated world is: textured rectangles to see, solid boxes to bump into, rooms and doors to name."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot.simulation.textures import TextureSpec
from shared.geometry import FloatArray

WALL_HEIGHT_M = 2.5
WALL_THICKNESS_M = 0.10


@dataclass(frozen=True, slots=True)
class Surface:
    """One textured rectangle, seen from its front only. Either upright (ev = -z) or level (ev horizontal)."""

    origin: tuple[float, float, float]  # m, world: the corner where u = v = 0 (top left, seen from the front)
    eu: tuple[float, float, float]  # unit vector of growing u (to the right)
    ev: tuple[float, float, float]  # unit vector of growing v (down the picture)
    width_m: float
    height_m: float
    texture: TextureSpec
    u0_m: float = 0.0  # where in the texture u = v = 0 lies
    v0_m: float = 0.0
    room: int = 0

    @property
    def normal(self) -> FloatArray:
        """(3,) unit vector towards the viewer."""
        return np.cross(self.ev, self.eu)

    def corners(self) -> FloatArray:
        """(4, 3) m, world, around the rectangle."""
        origin, eu, ev = np.array(self.origin), np.array(self.eu), np.array(self.ev)
        across, down = eu * self.width_m, ev * self.height_m
        return np.stack([origin, origin + across, origin + across + down, origin + down])


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A solid upright box that the robot cannot enter."""

    x_m: float
    y_m: float
    half_x_m: float
    half_y_m: float
    yaw_rad: float
    height_m: float
    name: str
    room: int


@dataclass(frozen=True, slots=True)
class Room:
    """The inside of one room, an upright rectangle of the floor plan."""

    name: str
    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float

    @property
    def centre(self) -> tuple[float, float]:
        return (self.x0_m + self.x1_m) / 2, (self.y0_m + self.y1_m) / 2

    def contains(self, x_m: float, y_m: float) -> bool:
        return self.x0_m <= x_m <= self.x1_m and self.y0_m <= y_m <= self.y1_m


@dataclass(frozen=True, slots=True)
class Door:
    """An opening between two rooms; `along` is the axis of the wall it sits in."""

    x_m: float
    y_m: float
    width_m: float
    along: str  # "x" or "y"
    rooms: tuple[int, int]


@dataclass(frozen=True, slots=True)
class World:
    """Everything there is. Frame: z up, metres, origin at a corner of the floor plan."""

    name: str
    seed: int
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    surfaces: tuple[Surface, ...]
    obstacles: tuple[Obstacle, ...]
    start: tuple[float, float, float]  # x m, y m, yaw rad of the robot
    room_light: tuple[float, ...] = ()  # brightness per room, 1 is normal; empty: all normal

    def room_at(self, x_m: float, y_m: float) -> str:
        """Name of the room at a position, "" outside of all (a doorway belongs to the nearer room)."""
        for room in self.rooms:
            if room.contains(x_m, y_m):
                return room.name
        if not self.rooms:
            return ""
        nearest = min(self.rooms, key=lambda r: _distance_to_room(r, x_m, y_m))
        return nearest.name if _distance_to_room(nearest, x_m, y_m) <= WALL_THICKNESS_M else ""

    def bounds(self) -> tuple[float, float, float, float]:
        """x0, y0, x1, y1 m of the floor plan."""
        return (
            min(r.x0_m for r in self.rooms),
            min(r.y0_m for r in self.rooms),
            max(r.x1_m for r in self.rooms),
            max(r.y1_m for r in self.rooms),
        )


def _distance_to_room(room: Room, x_m: float, y_m: float) -> float:
    dx = max(room.x0_m - x_m, 0.0, x_m - room.x1_m)
    dy = max(room.y0_m - y_m, 0.0, y_m - room.y1_m)
    return math.hypot(dx, dy)
