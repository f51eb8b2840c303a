"""Stickers that name the rooms of a world, hung where a robot sees them on its mapping drive."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from robot.simulation.routes import plan_route
from robot.simulation.textures import TextureSpec
from robot.simulation.world import Surface, World
from shared.geometry import FloatArray

PAGE_M = (0.21, 0.297)
FOOT_M = 0.1  # above the floor: the code then hangs at the height of the robot's camera
OFF_M = 0.005  # the page stands off what it is glued to; posters stand off 12 mm, and none is glued onto another
TEXELS_PER_M = 1000.0
STEP_M = 0.1  # between the spots that are tried
# From where a spot counts as seen: well inside of the narrowest camera's picture, near enough, not too oblique.
NEAR_M, FAR_M, HALF_VIEW_RAD, OBLIQUE_RAD = 0.7, 1.8, math.radians(12), math.radians(45)


def with_stickers(world: World, robot_radius_m: float) -> World:
    """The world with a sticker in each room, where the mapping route sees it from the most points.

    A room that the route sees no free spot of has none.
    """
    route = plan_route(world, "mapping", world.seed, robot_radius_m).points
    boxes = np.array([[o.x_m, o.y_m, o.half_x_m, o.half_y_m, o.yaw_rad] for o in world.obstacles])
    hung = []
    for index, room in enumerate(world.rooms):
        spots = spots_in(world, index)
        if not spots:
            continue
        seen = [_times_seen(spot, route, boxes) for spot in spots]
        best = int(np.argmax(seen))
        if seen[best]:
            hung.append(glued(spots[best], room.name[:1].upper() + room.name[1:]))
    return replace(world, surfaces=(*world.surfaces, *hung))


def glued(spot: Surface, name: str) -> Surface:
    """A sticker at a spot, lit as what it is glued to."""
    below = spot.texture
    glows = tuple(replace(g, u_m=g.u_m - spot.u0_m, v_m=g.v_m - spot.v0_m) for g in below.glows)
    texture = TextureSpec("sticker", 0, *PAGE_M, TEXELS_PER_M, below.ambient, glows, name)
    return replace(spot, texture=texture, u0_m=0.0, v0_m=0.0)


def spots_in(world: World, room: int) -> list[Surface]:
    """Where a page can be glued to an upright surface of a room; posters stand off further than a page."""
    width, height = PAGE_M
    spots = []
    for s in world.surfaces:
        top, bottom = s.origin[2], s.origin[2] - s.height_m
        if s.room != room or s.ev[2] > -0.5 or s.texture.kind == "poster" or s.width_m < width + 0.02:
            continue
        if bottom > FOOT_M or top < FOOT_M + height:
            continue
        origin, eu, out = np.array(s.origin), np.array(s.eu), s.normal
        for u in np.arange(0.01, s.width_m - width, STEP_M):
            x, y, _ = origin + u * eu + OFF_M * out
            corner = (float(x), float(y), FOOT_M + height)
            u0_m, v0_m = s.u0_m + float(u), s.v0_m + top - corner[2]
            spots.append(replace(s, origin=corner, width_m=width, height_m=height, u0_m=u0_m, v0_m=v0_m))
    pictures = [s for s in world.surfaces if s.room == room and s.texture.kind == "poster"]
    return [spot for spot in spots if not any(_overlap(spot, picture) for picture in pictures)]


def _overlap(a: Surface, b: Surface) -> bool:
    """Whether b hangs before a part of a."""
    corners = (b.corners() - np.array(a.origin)) @ np.stack([np.array(a.eu), np.array(a.ev), a.normal], axis=1)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return bool(
        low[0] < a.width_m and high[0] > 0 and low[1] < a.height_m and high[1] > 0 and low[2] < 0.05 and high[2] > 0.0
    )


def _times_seen(spot: Surface, route: FloatArray, boxes: FloatArray) -> int:
    """From how many points of a route, looking ahead, the spot is seen well."""
    ahead = np.gradient(route, axis=0)
    middle = np.array(spot.origin[:2]) + np.array(spot.eu[:2]) * spot.width_m / 2
    to_spot = middle - route
    distance = np.linalg.norm(to_spot, axis=1)
    bearing = np.arctan2(to_spot[:, 1], to_spot[:, 0]) - np.arctan2(ahead[:, 1], ahead[:, 0])
    off_axis = np.abs((bearing + math.pi) % (2 * math.pi) - math.pi)
    facing = -(to_spot @ spot.normal[:2]) / np.maximum(distance, 1e-6)
    seen = (distance > NEAR_M) & (distance < FAR_M) & (off_axis < HALF_VIEW_RAD) & (facing > math.cos(OBLIQUE_RAD))
    before = middle + 0.03 * spot.normal[:2]
    return sum(not _is_blocked(p, before, boxes) for p in route[seen])


def _is_blocked(a: FloatArray, b: FloatArray, boxes: FloatArray) -> bool:
    """Whether a segment of the floor plan crosses a box (x, y, half x, half y, yaw). Slab method."""
    c, s = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])

    def local(p: FloatArray) -> FloatArray:
        d = p - boxes[:, :2]
        return np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]], axis=1)

    start, step = local(a), local(b) - local(a)
    step = np.where(np.abs(step) < 1e-12, 1e-12, step)
    first, second = (-boxes[:, 2:4] - start) / step, (boxes[:, 2:4] - start) / step
    enter = np.minimum(first, second).max(axis=1)
    leave = np.maximum(first, second).min(axis=1)
    return bool(np.any((enter < leave) & (enter < 1) & (leave > 0)))
