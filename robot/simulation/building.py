"""Puts surfaces and obstacles together: walls with openings, boxes, pieces standing at a place."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from robot.simulation.textures import TextureSpec
from robot.simulation.world import WALL_HEIGHT_M, Obstacle, Surface

DOOR_HEIGHT_M = 2.05
SOLID_BELOW_M = 0.4  # boxes that start lower than this stop the robot
_UP = (0.0, 0.0, -1.0)


@dataclass(frozen=True, slots=True)
class Pose2:
    """Where a piece stands: its local x axis points along the wall, y into the room."""

    x_m: float
    y_m: float
    yaw_rad: float

    def at(self, local_x_m: float, local_y_m: float) -> tuple[float, float]:
        """World coordinates of a point given in the piece's own axes."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + c * local_x_m - s * local_y_m, self.y_m + s * local_x_m + c * local_y_m


def covering(texture: TextureSpec, width_m: float, height_m: float) -> TextureSpec:
    """The texture, made larger where a surface needs more of it."""
    if width_m <= texture.width_m + 0.002 and height_m <= texture.height_m + 0.002:
        return texture
    return replace(
        texture,
        width_m=round(max(width_m, texture.width_m), 3),
        height_m=round(max(height_m, texture.height_m), 3),
    )


@dataclass(slots=True)
class Builder:
    surfaces: list[Surface] = field(default_factory=list)
    obstacles: list[Obstacle] = field(default_factory=list)

    def upright(
        self,
        left: tuple[float, float],
        right: tuple[float, float],
        z_range: tuple[float, float],
        texture: TextureSpec,
        room: int,
        offset_m: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """A vertical rectangle; left and right as seen from its front."""
        span = np.subtract(right, left)
        length = float(np.hypot(*span))
        if length < 1e-6 or z_range[1] - z_range[0] < 1e-6:
            return
        eu = (float(span[0] / length), float(span[1] / length), 0.0)
        origin = (left[0], left[1], z_range[1])
        height = z_range[1] - z_range[0]
        texture = covering(texture, offset_m[0] + length, offset_m[1] + height)
        self.surfaces.append(Surface(origin, eu, _UP, length, height, texture, offset_m[0], offset_m[1], room))

    def level(
        self,
        pose: Pose2,
        size_m: tuple[float, float],
        z_m: float,
        texture: TextureSpec,
        room: int,
        facing_up: bool = True,
    ) -> None:
        """A horizontal rectangle centred at a pose."""
        c, s, sign = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad), 1.0 if facing_up else -1.0
        corner = (*pose.at(-size_m[0] / 2, sign * size_m[1] / 2), z_m)
        eu, ev = (c, s, 0.0), (sign * s, -sign * c, 0.0)
        self.surfaces.append(Surface(corner, eu, ev, *size_m, covering(texture, *size_m), room=room))

    def box(
        self,
        pose: Pose2,
        size_m: tuple[float, float, float],
        z0_m: float,
        room: int,
        name: str,
        front: TextureSpec,
        side: TextureSpec,
        top: TextureSpec,
        *,
        has_back: bool = True,
        solid: bool = True,
    ) -> None:
        """An upright box: size along local x, local y and up; its front looks along local +y."""
        hx, hy, z1 = size_m[0] / 2, size_m[1] / 2, z0_m + size_m[2]
        corner = {(i, j): pose.at(i * hx, j * hy) for i in (-1, 1) for j in (-1, 1)}
        z_range = (z0_m, z1)
        self.upright(corner[1, 1], corner[-1, 1], z_range, front, room)
        self.upright(corner[1, -1], corner[1, 1], z_range, side, room)
        self.upright(corner[-1, 1], corner[-1, -1], z_range, side, room)
        if has_back:
            self.upright(corner[-1, -1], corner[1, -1], z_range, side, room)
        if z1 < WALL_HEIGHT_M - 0.05:
            self.level(pose, (size_m[0], size_m[1]), z1, top, room)
        if z0_m > 0.2:
            self.level(pose, (size_m[0], size_m[1]), z0_m, side, room, facing_up=False)
        if solid and z0_m < SOLID_BELOW_M:
            self.obstacles.append(Obstacle(pose.x_m, pose.y_m, hx, hy, pose.yaw_rad, z1, name, room))


class TexturePicker:
    """Hands out textures: same kind and look give the same pixels, so pieces of one series look alike."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def new(self, kind: str, width_m: float, height_m: float, texels_per_m: float) -> TextureSpec:
        """A texture nobody else has."""
        return self.series(kind, int(self._rng.integers(0, 2**31)), width_m, height_m, texels_per_m)

    @staticmethod
    def series(kind: str, seed: int, width_m: float, height_m: float, texels_per_m: float) -> TextureSpec:
        """A texture that every piece of the same series shares."""
        return TextureSpec(kind, seed, round(width_m, 3), round(height_m, 3), texels_per_m)
