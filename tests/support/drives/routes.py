"""Routes through a flat of which one room is left out of the map, or none, and hijacks on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robot.simulation.routes import FreeSpace, Route, plan_route
from robot.simulation.world import Obstacle, World
from shared.errors import ConfigError
from shared.geometry import FloatArray

RADIUS_M = 0.21  # of the robot, as plan_route has it
THROUGH = "through the unmapped room"
MAPPED, UNMAPPED = "hijack to a mapped room", "hijack to the unmapped room"
PLANS = (THROUGH, MAPPED, UNMAPPED)
TWIN_PLANS = ("hijack to a twin", "hijack to its twin", "hijack to a twin again", "hijack to its twin again")


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
    rooms = _reachable(world)
    free = [k for k in rooms if _are_connected(world, rooms - {k})]
    return world.rooms[sorted(free)[world.seed % len(free)]].name


def _reachable(world: World) -> set[int]:
    """Rooms with free floor that a robot can drive to; furniture may fill one, or shut it off."""
    space = FreeSpace(world, RADIUS_M)
    return {k for k, room in enumerate(world.rooms) if len(space.free_points_in(room))}


def _are_connected(world: World, rooms: set[int]) -> bool:
    reached, border = set[int](), {min(rooms)}
    while border:
        reached |= border
        beside = {b for door in world.doors for a, b in (door.rooms, door.rooms[::-1]) if a in border}
        border = (beside & rooms) - reached
    return reached == rooms


def without_rooms(world: World, names: set[str]) -> World:
    """The flat with these rooms filled up and their doors gone, to plan a way that leads through none of them."""
    filled = [
        Obstacle(*room.centre, (room.x1_m - room.x0_m) / 2, (room.y1_m - room.y0_m) / 2, 0.0, 2.0, "filled", k)
        for k, room in enumerate(world.rooms)
        if room.name in names
    ]
    doors = tuple(d for d in world.doors if not names.intersection(_names(world, d.rooms)))
    return replace(world, doors=doors, obstacles=(*world.obstacles, *filled))


def mapping_route(world: World, left_out: str, seed: int, both_ways: bool = True) -> Route:
    """Round every room but one, both ways or one, and back."""
    start = _spot(world, _mapped(world, left_out), seed)
    kind = "tour" if both_ways else "mapping"
    return plan_route(without_rooms(world, {left_out}), kind, seed, start=start[:2])


def _mapped(world: World, left_out: str) -> list[str]:
    return sorted({world.rooms[k].name for k in _reachable(world)} - {left_out})


def plan_drive(world: World, left_out: str, name: str, seed: int) -> Plan:
    """A drive that starts in a mapped room.

    `THROUGH` goes into the room left out at once and is taken to a mapped room on the way back; the others
    go round all rooms and are taken to a mapped room, or to the one left out.
    """
    rng = np.random.default_rng([world.seed, seed, PLANS.index(name), 71])
    mapped = _mapped(world, left_out)
    beside = [room for room in _rooms_beside(world, left_out) if room in mapped] or mapped
    start_room = beside[int(rng.integers(len(beside)))] if name == THROUGH else mapped[int(rng.integers(len(mapped)))]
    start = _spot(world, [start_room], seed)[:2]
    flat = _only(world, {start_room, left_out}) if name == THROUGH else world
    route = plan_route(flat, "second", seed, start=start)
    at_s = float(rng.uniform(28, 36) if name == THROUGH else rng.uniform(12, 18))
    to_unmapped = name == UNMAPPED
    target = _spot(world, [left_out] if to_unmapped else mapped, seed + 1)
    then = plan_route(world, "second", seed + 1, start=target[:2])
    hijack = Hijack(at_s, target, to_unmapped, float(rng.uniform(0.3, 1.0)), float(rng.uniform(3, 6)), then)
    return Plan(name, route, hijack, at_s + 28.0)


def twin_rooms(world: World) -> tuple[int, int] | None:
    """Numbers of the two rooms of one use and shape; None in a world without."""
    number = {room.name: k for k, room in enumerate(world.rooms)}
    for name, second in number.items():
        first = number.get(name.removesuffix(" 2"), second)
        if first != second and np.allclose(_size(world, first), _size(world, second)):
            return first, second
    return None


def _size(world: World, k: int) -> tuple[float, float]:
    room = world.rooms[k]
    return room.x1_m - room.x0_m, room.y1_m - room.y0_m


def spot_in_twin(world: World, p_world: FloatArray) -> FloatArray | None:
    """Where (3,) in the twin of its room a position (3,) is; None outside of twin rooms."""
    twins = twin_rooms(world)
    if twins is None:
        return None
    a, b = (world.rooms[k] for k in twins)
    step = np.array([b.x0_m - a.x0_m, b.y0_m - a.y0_m, 0.0])
    return {a.name: p_world + step, b.name: p_world - step}.get(world.room_at(*p_world[:2]))


def plan_twin_drive(world: World, name: str, seed: int) -> Plan:
    """A drive through a flat whose every room is mapped; on it the robot is put down in one of two twin rooms."""
    number = TWIN_PLANS.index(name)
    twins = twin_rooms(world)
    if twins is None:
        raise ConfigError(f"world {world.name} with seed {world.seed} has no twin rooms")
    rng = np.random.default_rng([world.seed, seed, number, 73])
    start = _spot(world, _mapped(world, ""), seed)[:2]
    target = _spot(world, [world.rooms[twins[number % 2]].name], seed + 1)
    at_s = float(rng.uniform(8, 12))
    then = plan_route(world, "second", seed + 1, start=target[:2])
    hijack = Hijack(at_s, target, False, float(rng.uniform(0.3, 1.0)), float(rng.uniform(3, 6)), then)
    return Plan(name, plan_route(world, "second", seed, start=start), hijack, at_s + 28.0)


def _only(world: World, rooms: set[str]) -> World:
    """The flat without all other rooms; the whole flat where there is no way between these then."""
    part = without_rooms(world, {r.name for r in world.rooms} - rooms)
    return part if {part.rooms[k].name for k in _reachable(part)} == rooms else world


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
