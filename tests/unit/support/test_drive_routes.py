"""Routes of recorded drives: the map lacks one room, the others stay connected."""

from __future__ import annotations

import numpy as np
import pytest

from robot.simulation.worlds import make_world
from shared.geometry import FloatArray
from tests.support.drives.routes import (
    PLANS,
    THROUGH,
    TWIN_PLANS,
    UNMAPPED,
    beyond_door_m,
    mapping_route,
    plan_drive,
    plan_twin_drive,
    room_left_out,
    spot_in_twin,
    twin_rooms,
)

FLATS = [("small", 3), ("home", 3), ("lookalike", 2)]  # of small 3 the room left out is the largest part


def rooms_on(world_points: FloatArray, kind: str, seed: int) -> set[str]:
    world = make_world(kind, seed)
    return {world.room_at(*p) for p in world_points} - {""}


@pytest.mark.parametrize(("kind", "seed"), FLATS)
def test_the_mapping_route_goes_through_every_room_but_one(kind: str, seed: int) -> None:
    world = make_world(kind, seed)
    left_out = room_left_out(world)
    route = mapping_route(world, left_out, seed)
    assert rooms_on(route.points, kind, seed) == {r.name for r in world.rooms} - {left_out}
    assert np.linalg.norm(route.points[0] - route.points[-1]) < 0.1


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize(("kind", "seed"), FLATS)
def test_drives_start_where_the_map_is_and_end_where_they_say(kind: str, seed: int, name: str) -> None:
    world = make_world(kind, seed)
    left_out = room_left_out(world)
    plan = plan_drive(world, left_out, name, seed)
    assert plan.hijack is not None
    assert world.room_at(*plan.route.points[0]) != left_out
    assert (world.room_at(*plan.hijack.target[:2]) == left_out) == (name == UNMAPPED)
    assert np.linalg.norm(plan.hijack.then.points[0] - plan.hijack.target[:2]) < 0.1
    if name == THROUGH:
        assert left_out in rooms_on(plan.route.points, kind, seed)


def test_the_way_beyond_a_door_is_measured_in_the_room_left_out_only() -> None:
    world = make_world("small", 0)
    left_out = room_left_out(world)
    room = next(r for r in world.rooms if r.name == left_out)
    for other in world.rooms:
        beyond_m = beyond_door_m(world, left_out, np.array([*other.centre, 0.25]))
        assert (beyond_m > 0.5) if other is room else beyond_m == 0.0


@pytest.mark.parametrize("name", TWIN_PLANS)
def test_where_no_room_is_left_out_the_robot_is_put_down_in_either_twin(name: str) -> None:
    world = make_world("lookalike", 2)
    twins = [world.rooms[k].name for k in twin_rooms(world) or ()]
    hijack = plan_twin_drive(world, name, 5).hijack
    assert hijack is not None and world.room_at(*hijack.target[:2]) == twins[TWIN_PLANS.index(name) % 2]
    assert rooms_on(mapping_route(world, "", 2).points, "lookalike", 2) == {r.name for r in world.rooms}


def test_a_spot_in_one_twin_is_the_same_spot_of_the_other() -> None:
    world = make_world("lookalike", 2)
    first, second = (world.rooms[k] for k in twin_rooms(world) or ())
    spot = np.array([*first.centre, 0.1])
    other = spot_in_twin(world, spot)
    assert other is not None and world.room_at(*other[:2]) == second.name
    back = spot_in_twin(world, other)
    assert back is not None and back == pytest.approx(spot)
    assert spot_in_twin(world, np.array([*world.rooms[0].centre, 0.1])) is None


def test_a_world_whose_rooms_differ_has_no_twins() -> None:
    assert twin_rooms(make_world("home", 3)) is None
