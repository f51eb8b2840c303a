"""The named worlds of `--world`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robot.simulation.building import Builder, Pose2, TexturePicker
from robot.simulation.config import SimulationConfig
from robot.simulation.flat import FlatOptions, furnish_room, make_flat
from robot.simulation.plain import make_plain
from robot.simulation.stickers import with_stickers
from robot.simulation.textures import TextureSpec
from robot.simulation.walkers import with_walkers
from robot.simulation.walls import wall_obstacles
from robot.simulation.world import Room, World
from shared.errors import ConfigError

WORLD_NAMES = ("home", "small", "lookalike", "plain", "corner", "large", "room", "vicon", "checker")


PLAIN_WALKERS = (0, 0, 1, 2)  # persons in a plain home, by chance


def make_world(name: str, seed: int, config: SimulationConfig | None = None) -> World:
    """Build a world by name: the same name, seed and options give the same world.

    `home`: a flat of 3-5 rooms. `small`: 3 rooms, mapped in about a minute. `lookalike`: a home in
    which two rooms differ in nothing but their pictures. `plain`: another kind of home, with bare walls,
    equal doors and radiators, by day or by night,
    some with twin rooms, some with persons who walk about. `corner`: a plain home whose living room is an L,
    two rectangles of one name. `large`: a plain home of six to eight rooms off a long corridor.
    `room`: one room for the triangle routes.
    `vicon`: an 8x8x4 m hall around EuRoC's V1 paths. `checker`: a box of checkerboards, for geometry tests.
    """
    config = config or SimulationConfig()
    walkers = config.walkers
    if walkers is None:
        walkers = int(np.random.default_rng([seed, 26]).choice(PLAIN_WALKERS)) if name == "plain" else 0
    world = _make_world(name, seed, config)
    if config.stickers:
        world = with_stickers(world, config.body.radius_m)
    return with_walkers(world, walkers, config.walkers_seed)


def _make_world(name: str, seed: int, config: SimulationConfig) -> World:
    moved, light = config.moved_chairs_seed, config.light_seed
    if name in ("home", "lookalike", "small"):
        options = FlatOptions(
            lookalike_rooms=name == "lookalike" or config.lookalike_rooms,
            identical_twins=config.identical_twins,
            moved_chairs_seed=moved,
            light_seed=light,
        )
        return make_flat(
            name, seed, replace(options, rooms=(3, 3), room_area_m2=(8.4, 9.6)) if name == "small" else options
        )
    if name in ("plain", "corner", "large"):
        return make_plain(name, seed, config.lookalike_rooms, moved, light, config.identical_twins)
    if name == "room":
        return _single_room(seed, moved, light)
    if name == "vicon":
        return _hall(seed)
    if name == "checker":
        return _checker_box()
    raise ConfigError(f"world {name!r} is unknown; choose one of {', '.join(WORLD_NAMES)}")


def _single_room(seed: int, moved_seed: int | None, light_seed: int | None) -> World:
    """One furnished room of about 4.6 x 4.2 m without doors."""
    rng = np.random.default_rng([seed, 5])
    room = Room("living room", 0.05, 0.05, float(rng.uniform(4.4, 4.9)), float(rng.uniform(4.2, 4.6)))
    builder = Builder()
    furnish_room(builder, room, 0, [], int(rng.integers(0, 2**31)), int(rng.integers(0, 4)), moved_seed)
    light = () if light_seed is None else (float(np.random.default_rng([light_seed, 3]).uniform(0.5, 1.3)),)
    return World(
        "room", seed, (room,), (), tuple(builder.surfaces), tuple(builder.obstacles), (*room.centre, 0.0), light
    )


HALL = Room("hall", -3.6, -3.2, 4.4, 4.8)  # EuRoC's Vicon room, roughly: the recorded paths stay within its middle
HALL_HEIGHT_M = 4.0


def _hall(seed: int) -> World:
    """Rich walls, mats on the floor, boxes and people-like stands along the sides."""
    rng = np.random.default_rng([seed, 6])
    pick = TexturePicker(rng)
    builder, room, height = Builder(), HALL, HALL_HEIGHT_M
    corners = [(room.x1_m, room.y0_m), (room.x0_m, room.y0_m), (room.x0_m, room.y1_m), (room.x1_m, room.y1_m)]
    for k in range(4):
        left, right = np.array(corners[k]), np.array(corners[(k + 1) % 4])
        length = float(np.hypot(*(right - left)))
        kind = ("plaster", "brick", "wallpaper", "plaster")[k]
        builder.upright(tuple(left), tuple(right), (0.0, height), pick.new(kind, length, height, 160), 0)
        along = (right - left) / length
        inward = np.array([along[1], -along[0]])  # to the right on the way from corner to corner
        for row in range(2):
            s = 0.1
            while s < length - 0.8:
                w, t = float(rng.uniform(0.5, 1.3)), float(rng.uniform(0.5, 1.2))
                z0 = 0.25 + 1.75 * row + float(rng.uniform(0.0, 0.4))
                a, b = left + along * s + 0.01 * inward, left + along * (s + w) + 0.01 * inward
                texture = pick.new("poster" if rng.random() < 0.8 else "books", w, t, 250)
                builder.upright(tuple(a), tuple(b), (z0, z0 + t), texture, 0)
                s += w + float(rng.uniform(0.05, 0.5))
    centre = Pose2(*room.centre, 0.0)
    size = (room.x1_m - room.x0_m, room.y1_m - room.y0_m)
    builder.level(centre, size, 0.0, pick.new("floor_tiles", *size, 150), 0)
    builder.level(centre, size, height, pick.new("planks", *size, 100), 0, facing_up=False)
    for _ in range(9):
        at = Pose2(
            centre.x_m + float(rng.uniform(-3, 3)),
            centre.y_m + float(rng.uniform(-3, 3)),
            float(rng.uniform(0, np.pi)),
        )
        mat = (float(rng.uniform(0.8, 1.8)), float(rng.uniform(0.6, 1.4)))
        z = 0.004 + 0.001 * len(builder.surfaces) % 0.02
        builder.level(at, mat, z, pick.new("rug" if rng.random() < 0.5 else "poster", *mat, 250), 0)
    for _ in range(14):
        angle = float(rng.uniform(0, 2 * np.pi))
        reach = float(rng.uniform(2.6, 3.3))
        at = Pose2(centre.x_m + reach * np.cos(angle), centre.y_m + reach * np.sin(angle), float(rng.uniform(0, 6)))
        w, d, t = float(rng.uniform(0.3, 0.8)), float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.3, 1.0))
        front = pick.new("box_print" if rng.random() < 0.6 else "books", w, t, 300)
        side, top = pick.new("fabric", d, t, 250), pick.new("box_print", w, d, 250)
        builder.box(at, (w, d, t), 0.0, 0, "box", front, side, top)
    builder.obstacles += wall_obstacles(room, 0, [])
    return World("vicon", seed, (room,), (), tuple(builder.surfaces), tuple(builder.obstacles), (*room.centre, 0.0))


def _checker_box() -> World:
    """A room of 4x4x2.5 m whose walls, floor and a box carry 0.1 m checkerboards at known places."""
    room = Room("box", 0.0, 0.0, 4.0, 4.0)
    board = TextureSpec("checker", 0, 4.0, 4.0, 600.0)
    builder = Builder()
    corners = [(4.0, 0.0), (0.0, 0.0), (0.0, 4.0), (4.0, 4.0)]
    for k in range(4):
        builder.upright(corners[k], corners[(k + 1) % 4], (0.0, 2.5), board, 0)
    builder.level(Pose2(2.0, 2.0, 0.0), (4.0, 4.0), 0.0, board, 0)
    cube = replace(board, width_m=0.5, height_m=0.5)
    builder.box(Pose2(3.0, 2.2, 0.4), (0.5, 0.5, 0.5), 0.0, 0, "cube", cube, cube, cube)
    builder.obstacles += wall_obstacles(room, 0, [])
    return World("checker", 0, (room,), (), tuple(builder.surfaces), tuple(builder.obstacles), (2.0, 2.0, 0.0))
