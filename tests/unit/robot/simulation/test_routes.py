"""Routes keep clear of everything solid, reach every room, and a driver with slipping wheels gets to their end."""

import numpy as np
import pytest

from robot.simulation.body import TICK_S, Body, CollisionBoxes
from robot.simulation.config import BodyParameters
from robot.simulation.driver import BRISK, CALM, Pace, RouteDriver
from robot.simulation.routes import FreeSpace, Route, plan_route
from robot.simulation.world import World
from robot.simulation.worlds import make_world
from shared.errors import ConfigError
from shared.geometry import FloatArray

RADIUS_M = BodyParameters().radius_m


def rooms_on(world: World, points: np.ndarray) -> set[str]:
    return {world.room_at(float(x), float(y)) for x, y in points} - {""}


@pytest.mark.parametrize("seed", range(30))
def test_mapping_route_is_clear_and_visits_every_room_of_the_flat(seed: int) -> None:
    world = make_world("small" if seed % 2 else "home", seed)
    route = plan_route(world, "mapping")
    assert CollisionBoxes(world).clearance(route.points).min() > RADIUS_M
    assert rooms_on(world, route.points) == {room.name for room in world.rooms}
    assert np.hypot(*(route.points[-1] - route.points[0])) < 0.5
    assert np.hypot(*np.diff(route.points, axis=0).T).max() < 0.08


@pytest.mark.parametrize("kind", ["second", "local", "tour"])
def test_a_route_begins_where_the_robot_is(kind: str) -> None:
    world = make_world("home", 2)
    space = FreeSpace(world, RADIUS_M)
    x, y = space.free_points_in(world.rooms[1])[7]
    route = plan_route(world, kind, 3, start=(float(x), float(y)))
    assert route.points[0] == pytest.approx((x, y), abs=0.1)
    assert CollisionBoxes(world).clearance(route.points).min() > RADIUS_M - 0.02
    visited = rooms_on(world, route.points)
    assert visited == {world.rooms[1].name} if kind == "local" else visited == {r.name for r in world.rooms}


def test_other_seeds_give_other_routes_and_the_same_seed_the_same() -> None:
    world = make_world("small", 4)
    first, again, other = (plan_route(world, "second", seed).points for seed in (1, 1, 2))
    assert first.shape == again.shape and (first == again).all()
    assert first.shape != other.shape or np.abs(first - other).max() > 0.05


def test_triangles_cross_the_room_on_different_ways() -> None:
    world = make_world("room", 5)
    a, b, c = (plan_route(world, f"triangle_{k}").points for k in "abc")
    assert np.hypot(*(a[0] - b[0])) > 0.2
    distance_to_a = np.hypot(c[:, None, 0] - a[None, :, 0], c[:, None, 1] - a[None, :, 1]).min(1)
    assert distance_to_a.max() > 0.3


def test_an_unknown_kind_is_named() -> None:
    with pytest.raises(ConfigError, match="spiral"):
        plan_route(make_world("room", 0), "spiral")


@pytest.mark.parametrize(
    ("kind", "seed", "pace"),
    [("small", 3, CALM), ("small", 30, BRISK), ("home", 31, CALM), ("home", 34, BRISK), ("plain", 30, BRISK)],
)
def test_the_driver_of_a_tour_turns_both_ways_round_in_every_room(kind: str, seed: int, pace: Pace) -> None:
    world = make_world(kind, seed)
    route = plan_route(world, "tour")
    path = driven(world, route, seed, pace)
    turned = np.diff(np.unwrap(path[:, 2]))
    for room in world.rooms:
        inside = np.array([world.room_at(x, y) == room.name for x, y in path[1:, :2]])
        assert turned[inside & (turned > 0)].sum() > np.pi
        assert turned[inside & (turned < 0)].sum() < -np.pi
    assert np.hypot(*(route.points[-1] - path[-1, :2])) < 0.3


def test_a_brisk_driver_comes_to_the_end_sooner() -> None:
    world = make_world("small", 3)
    route = plan_route(world, "tour")
    calm, brisk = (driven(world, route, 3, pace) for pace in (CALM, BRISK))
    assert len(brisk) < 0.8 * len(calm)


def driven(world: World, route: Route, seed: int, pace: Pace) -> FloatArray:
    """Poses (N, 3) x m, y m, yaw rad of a robot on slipping wheels."""
    body = Body(world, BodyParameters(), (*route.points[0], route.start_yaw_rad), seed)
    driver, state, poses = RouteDriver(route, pace=pace), body.state(), [body.pose]
    while not driver.is_done and len(poses) * TICK_S < 400:
        if len(poses) % 15 == 0:
            command = driver.command(*body.pose, float(state.omega_body[2]))
            body.command(command.linear_m_s, command.angular_rad_s)
        state = body.step()
        poses.append(body.pose)
    assert driver.is_done
    return np.array(poses)


@pytest.mark.parametrize(("kind", "pace"), [("mapping", CALM), ("tour", BRISK)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_driver_reaches_the_end_of_the_route_on_slipping_wheels(seed: int, kind: str, pace: Pace) -> None:
    world = make_world("small", seed)
    route = plan_route(world, kind)
    body = Body(world, BodyParameters(), (*route.points[0], route.start_yaw_rad), seed)
    driver, state, ticks, blocked = RouteDriver(route, pace=pace), body.state(), 0, 0
    while not driver.is_done and ticks * TICK_S < 200:
        if ticks % 15 == 0:
            command = driver.command(*body.pose, float(state.omega_body[2]))
            body.command(command.linear_m_s, command.angular_rad_s)
        state = body.step()
        ticks += 1
        blocked += body.is_blocked
    assert driver.is_done
    assert blocked * TICK_S < 1.0
    assert np.hypot(*(route.points[-1] - body.pose[:2])) < 0.3
