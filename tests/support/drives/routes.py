"""Routes through a flat of which one room is left out of the map, and hijacks on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robot.simulation.routes import FreeSpace, Route, plan_route
from robot.simulation.world import Obstacle, World
from shared.geometry import FloatArray

RADIUS_M = 0.21  # of the robot, as plan_route has it
THROUGH = "through the unmapped room"
MAPPED, UNMAPPED = "hijack to a mapped room", "hijack to the unmapped room"
PLANS = (THROUGH, MAPPED, UNMAPPED)


@dataclass(frozen=True, slots=True, eq=False)
class Hijack:
    """When a hand takes the robot and where it is put down."""

    at_s: float
    target: tuple[float, float, float]  # x m, y m, yaw rad
    to_unmapped: bool
    goes_on_s: float  # the driver does not see it at once
    looks_around_s: float  # put down, he turns on the spot for so long
    then: Route  # ... and drives on


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A drive to localise."""

    name: str
    route: Route
    hijack: Hijack | None
    seconds: float


def room_left_out(world: World) -> str:
    """A room that the others can be reached without, chosen by the seed."""
    free = [k for k in range(len(world.rooms)) if _is_connected_without(world, k)]
    return world.rooms[free[world.seed % len(free)]].name


def _is_connected_without(world: World, left_out: int) -> bool:
    rest = set(range(len(world.rooms))) - {left_out}
    reached, border = set[int](), {min(rest)}
    while border:
        reached |= border
        beside = {b for door in world.doors for a, b in (door.rooms, door.rooms[::-1]) if a in border}
        border = (beside & rest) - reached
    return reached == rest


def walled_off(world: World, rooms: set[str]) -> World:
    """The flat with every door shut that leads into one of these rooms."""
    shut = [d for d in world.doors if any(world.rooms[r].name in rooms for r in d.rooms)]
    walls = [
        Obstacle(
            d.x_m, d.y_m, *((d.width_m / 2, 0.05) if d.along == "x" else (0.05, d.width_m / 2)), 0.0, 2.0, "door", 0
        )
        for d in shut
    ]
    doors = tuple(d for d in world.doors if d not in shut)
    return replace(world, doors=doors, obstacles=(*world.obstacles, *walls))


def mapping_route(world: World, left_out: str, seed: int) -> Route:
    """Through every room but one, and back."""
    start = world.start[:2]
    if world.room_at(*start) == left_out:
        start = _spot(world, [r.name for r in world.rooms if r.name != left_out], seed)[:2]
    return plan_route(walled_off(world, {left_out}), "mapping", seed, start=start)


def plan_drive(world: World, left_out: str, name: str, seed: int) -> Plan:
    """A drive that starts in a mapped room.

    `THROUGH` goes into the room left out at once and is taken to a mapped room on the way back; the others
    go round all rooms and are taken to a mapped room, or to the one left out.
    """
    rng = np.random.default_rng([world.seed, seed, PLANS.index(name), 71])
    mapped = [r.name for r in world.rooms if r.name != left_out]
    beside = _rooms_beside(world, left_out)
    start_room = beside[int(rng.integers(len(beside)))] if name == THROUGH else mapped[int(rng.integers(len(mapped)))]
    start = _spot(world, [start_room], seed)[:2]
    others = {r.name for r in world.rooms} - {start_room, left_out} if name == THROUGH else set()
    route = plan_route(walled_off(world, others), "second", seed, start=start)
    at_s = float(rng.uniform(28, 36) if name == THROUGH else rng.uniform(12, 18))
    to_unmapped = name == UNMAPPED
    target = _spot(world, [left_out] if to_unmapped else mapped, seed + 1)
    then = plan_route(world, "second", seed + 1, start=target[:2])
    hijack = Hijack(at_s, target, to_unmapped, float(rng.uniform(0.3, 1.0)), float(rng.uniform(3, 6)), then)
    return Plan(name, route, hijack, at_s + 28.0)


def _rooms_beside(world: World, room: str) -> list[str]:
    names = [world.rooms[r].name for door in world.doors for r in door.rooms if room in _names(world, door.rooms)]
    return sorted(set(names) - {room})


def _names(world: World, rooms: tuple[int, int]) -> list[str]:
    return [world.rooms[r].name for r in rooms]


def _spot(world: World, rooms: list[str], seed: int) -> tuple[float, float, float]:
    chosen = rooms[int(np.random.default_rng([world.seed, seed, 72]).integers(len(rooms)))]
    return FreeSpace(world, RADIUS_M).random_spot(seed, chosen)


def beyond_door_m(world: World, room: str, p_world: FloatArray) -> float:
    """How far (m) a position (3,) in a room lies from the nearest of its doors; 0 outside of the room."""
    if world.room_at(*p_world[:2]) != room:
        return 0.0
    distances = []
    for door in world.doors:
        if room in _names(world, door.rooms):
            half = np.array([door.width_m / 2, 0.0] if door.along == "x" else [0.0, door.width_m / 2])
            gap = np.abs(p_world[:2] - (door.x_m, door.y_m)) - half
            distances.append(float(np.hypot(*np.maximum(gap, 0.0))))
    return max(min(distances, default=np.inf), 1e-6)
