"""What a simulated world is: textured rectangles to see, solid boxes to bump into, rooms and doors to name."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
        (a, b, c), (d, e, f) = self.ev, self.eu
        return np.array([b * f - c * e, c * d - a * f, a * e - b * d])  # np.cross takes ten times as long for one

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
class Walker:
    """A person who walks a closed way again and again, stands a while at its stops and turns there."""

    times_s: tuple[float, ...]  # of the way's points, from 0 to when it begins anew
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    yaw_rad: tuple[float, ...]  # unwrapped
    surfaces: tuple[Surface, ...]  # in the person's own frame: x ahead, z up, the floor at 0
    swings_m: tuple[float, ...]  # how far each surface swings along x with the steps
    step_rad_s: float  # of the legs

    def pose(self, t_s: float) -> tuple[float, float, float]:
        """x m, y m, yaw rad at a time."""
        t = t_s % self.times_s[-1]
        x, y, yaw = (float(np.interp(t, self.times_s, values)) for values in (self.x_m, self.y_m, self.yaw_rad))
        return x, y, yaw

    def surfaces_at(self, t_s: float, room: int) -> list[Surface]:
        """What is seen of the person at a time, lit as the room is."""
        x, y, yaw = self.pose(t_s)
        before, after = self.pose(t_s - 0.05), self.pose(t_s + 0.05)
        is_walking = math.hypot(after[0] - before[0], after[1] - before[1]) > 0.02
        swing = math.sin(self.step_rad_s * t_s) if is_walking else 0.0
        c, s = math.cos(yaw), math.sin(yaw)

        def turned(v: tuple[float, float, float]) -> tuple[float, float, float]:
            return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]

        placed = []
        for surface, reach in zip(self.surfaces, self.swings_m, strict=True):
            ox, oy, oz = surface.origin
            ox, oy, oz = turned((ox + swing * reach, oy, oz))
            eu, ev = turned(surface.eu), turned(surface.ev)
            placed.append(replace(surface, origin=(x + ox, y + oy, oz), eu=eu, ev=ev, room=room))
        return placed


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
    walkers: tuple[Walker, ...] = ()

    def room_at(self, x_m: float, y_m: float) -> str:
        """Name of the room at a position, "" outside of all (a doorway belongs to the nearer room)."""
        for room in self.rooms:
            if room.contains(x_m, y_m):
                return room.name
        if not self.rooms:
            return ""
        nearest = min(self.rooms, key=lambda r: _distance_to_room(r, x_m, y_m))
        return nearest.name if _distance_to_room(nearest, x_m, y_m) <= WALL_THICKNESS_M else ""

    def room_index(self, x_m: float, y_m: float) -> int:
        """Index of the room nearest to a position."""
        return min(range(len(self.rooms)), key=lambda i: _distance_to_room(self.rooms[i], x_m, y_m))

    def surfaces_at(self, t_s: float) -> list[Surface]:
        """All that is seen at a time: the surfaces of the world, then those of the walkers, always in one order."""
        moving = [s for w in self.walkers for s in w.surfaces_at(t_s, self.room_index(*w.pose(t_s)[:2]))]
        return [*self.surfaces, *moving]

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
