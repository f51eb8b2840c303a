"""Persons who walk through the rooms of a world: seen by the camera, not solid, unaware of the robot."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from robot.simulation.building import Builder, Pose2, TexturePicker
from robot.simulation.routes import SPACING_M, FreeSpace
from robot.simulation.world import Surface, Walker, World
from shared.geometry import FloatArray

RADIUS_M = 0.2  # keeps that far from furniture
NUM_STOPS = 4
SPEED_M_S = (0.7, 1.1)
PAUSE_S = (2.0, 8.0)
SMOOTH_POINTS = 9  # corners are cut over half a metre
STEP_M, SWING_M = 0.65, 0.2  # length of a step; how far a leg swings to the front and back


def with_walkers(world: World, count: int, seed: int) -> World:
    """The world with persons in it; another seed sends other persons other ways."""
    if count == 0:
        return world
    space = FreeSpace(world, RADIUS_M)
    ambient = min((s.texture.ambient for s in world.surfaces), default=1.0)
    walkers = (_walker(space, np.random.default_rng([world.seed, seed, k, 25]), ambient) for k in range(count))
    return replace(world, walkers=tuple(walkers))


def _walker(space: FreeSpace, rng: np.random.Generator, ambient: float) -> Walker:
    """From stop to stop and back to the first one, with a pause at each."""
    rooms = space.world.rooms
    stops = []
    for index in rng.permutation(len(rooms) * NUM_STOPS)[:NUM_STOPS] % len(rooms):
        free = space.free_points_in(rooms[int(index)])
        stops.append(free[int(rng.integers(0, len(free)))])
    speed = float(rng.uniform(*SPEED_M_S))
    times, places, yaws = [0.0], [stops[0]], list[float]()
    for start, goal in zip(stops, [*stops[1:], stops[0]], strict=True):
        path = _smooth(space.path(start, goal))
        heading = np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::-1])) if len(path) > 1 else np.zeros(1)
        yaws = yaws or [float(heading[0])]
        steps = np.hypot(*np.diff(path, axis=0).T) / speed
        begin = times[-1] + float(rng.uniform(*PAUSE_S))
        times += (begin + np.concatenate([[0.0], np.cumsum(steps)])).tolist()
        places += list(path)
        yaws += (heading + _whole_turns(yaws[-1] - float(heading[0]))).tolist()
    times.append(times[-1] + PAUSE_S[0])
    places.append(stops[0])
    yaws.append(yaws[0] + _whole_turns(yaws[-1] - yaws[0]))
    surfaces, swings = _body(rng, ambient)
    x, y = np.array(places).T.tolist()
    return Walker(tuple(times), tuple(x), tuple(y), tuple(yaws), surfaces, swings, math.pi * speed / STEP_M)


def _whole_turns(angle_rad: float) -> float:
    """The multiple of a full turn nearest to an angle: whoever stands turns the shorter way round."""
    return 2 * math.pi * round(angle_rad / (2 * math.pi))


def _smooth(path: FloatArray) -> FloatArray:
    """Corners of the grid's path cut off, points evenly spaced."""
    if len(path) < 2:
        return path
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    wanted = np.linspace(0.0, s[-1], max(2, int(s[-1] / SPACING_M) + 1))
    even = np.column_stack([np.interp(wanted, s, path[:, 0]), np.interp(wanted, s, path[:, 1])])
    kernel = np.full((SMOOTH_POINTS, 1), 1.0 / SMOOTH_POINTS)
    smooth = np.asarray(cv2.filter2D(even, -1, kernel, borderType=cv2.BORDER_REPLICATE), dtype=np.float64)
    smooth[[0, -1]] = even[[0, -1]]  # where the next way begins
    return smooth


def _body(rng: np.random.Generator, ambient: float) -> tuple[tuple[Surface, ...], tuple[float, ...]]:
    """Boxes around the origin, facing +x, and how far (m) each surface swings along x with the steps."""
    pick = TexturePicker(rng)
    trousers, shirt = pick.new("garment", 0.2, 0.85, 300), pick.new("garment", 0.44, 0.62, 300)
    head, shoe = pick.new("head", 0.2, 0.25, 300), pick.new("lacquer", 0.26, 0.09, 300)
    builder, swings = Builder(), list[float]()
    for side in (-1.0, 1.0):
        leg, foot = Pose2(0.0, 0.1 * side, -math.pi / 2), Pose2(0.05, 0.1 * side, -math.pi / 2)
        builder.box(foot, (0.1, 0.26, 0.08), 0.0, 0, "person", shoe, shoe, shoe, solid=False)
        builder.box(leg, (0.14, 0.16, 0.76), 0.08, 0, "person", trousers, trousers, trousers, solid=False)
        swings += [side * SWING_M] * (len(builder.surfaces) - len(swings))
    middle = Pose2(0.0, 0.0, -math.pi / 2)
    builder.box(middle, (0.42, 0.24, 0.6), 0.82, 0, "person", shirt, shirt, shirt, solid=False)
    builder.box(middle, (0.17, 0.2, 0.25), 1.44, 0, "person", head, head, head, solid=False)
    swings += [0.0] * (len(builder.surfaces) - len(swings))
    lit = (replace(s, texture=replace(s.texture, ambient=ambient)) for s in builder.surfaces)
    return tuple(lit), tuple(swings)
