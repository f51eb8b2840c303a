"""Plain homes: whole plans, free doors, twins that differ in their pictures only, day and night, drivable."""

import math

import cv2
import numpy as np
import pytest

from robot.simulation.body import TICK_S, Body, CollisionBoxes
from robot.simulation.config import BodyParameters, SimulationConfig
from robot.simulation.driver import RouteDriver
from robot.simulation.plain import Lamp, lit
from robot.simulation.routes import FreeSpace, plan_route
from robot.simulation.texture_strokes import ImageArray
from robot.simulation.textures import LAMP_SIZE_M, TextureSpec, paint
from robot.simulation.world import Surface, World
from robot.simulation.worlds import make_world
from station.vision.features import FeatureExtractor

THINGS = {  # size in m
    "spines": (0.3, 0.25),
    "bottle": (0.08, 0.25),
    "bowl": (0.2, 0.1),
    "labelled_box": (0.25, 0.15),
    "toy_box": (0.5, 0.35),
    "patterned_cloth": (0.4, 0.4),
    "wicker": (0.34, 0.4),
    "shoe": (0.27, 0.09),
    "power_strip": (0.36, 0.06),
    "clock": (0.26, 0.26),
    "note_board": (0.5, 0.4),
    "wall_tiles": (0.6, 0.5),
}
ON_WALLS = {"white_paint", "print", "clock", "note_board", "power_strip", "socket", "switch"}
TWINS = SimulationConfig(lookalike_rooms=True)


def kinds(world: World) -> set[str]:
    return {s.texture.kind for s in world.surfaces}


def count_features(image: ImageArray) -> int:
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    return len(FeatureExtractor().extract(grey))


def twin_indices(world: World) -> tuple[int, int]:
    second = next(i for i, room in enumerate(world.rooms) if room.name.endswith(" 2"))
    return [room.name for room in world.rooms].index(world.rooms[second].name.removesuffix(" 2")), second


def seen_in(world: World, room: int) -> set[tuple[object, ...]]:
    """Look and place, from the room's corner, of everything in a room but floor, frames of its doors and pictures."""
    corner = np.array([world.rooms[room].x0_m, world.rooms[room].y0_m, 0.0])
    return {
        (s.texture.kind, s.texture.seed, *np.round(np.array(s.origin) - corner, 5).tolist())
        for s in world.surfaces
        if s.room == room and s.texture.kind != "print"
    }


def test_forty_seeds_give_forty_homes_by_day_and_night_with_and_without_corridor_and_twins() -> None:
    worlds = [make_world("plain", seed) for seed in range(40)]
    assert len({tuple((r.x0_m, r.y0_m, r.x1_m, r.y1_m) for r in w.rooms) for w in worlds}) == 40
    for world in worlds:
        assert 3 <= len(world.rooms) <= 5
        assert len({room.name for room in world.rooms}) == len(world.rooms)
        assert len(world.doors) == len(world.rooms) - 1
    for is_special in (
        lambda w: "window_night" in kinds(w),
        lambda w: any(room.name == "hall" for room in w.rooms),
        lambda w: any(room.name.endswith(" 2") for room in w.rooms),
        lambda w: max(door.width_m for door in w.doors) > 1.5,
    ):
        assert 4 <= sum(map(is_special, worlds)) <= 32


def test_no_texture_is_shared_with_the_flats() -> None:
    flats = set[str]().union(*(kinds(make_world("home", seed)) for seed in range(6)))
    assert not flats & set[str]().union(*(kinds(make_world("plain", seed)) for seed in range(6)))


def test_a_home_repeats_its_radiators_and_closed_doors() -> None:
    for seed in range(12):
        world = make_world("plain", seed)
        for kind in ("radiator", "door_leaf"):
            looks = {(s.texture.seed, s.texture.texels_per_m) for s in world.surfaces if s.texture.kind == kind}
            assert len(looks) <= 1


@pytest.mark.parametrize("seed", range(12))
def test_every_home_has_things_that_are_printed_or_woven_and_mostly_bare_walls(seed: int) -> None:
    world = make_world("plain", seed)
    assert len(kinds(world) & set(THINGS)) >= 6
    for index in range(len(world.rooms)):
        areas = {
            is_wall: sum(
                s.width_m * s.height_m
                for s in world.surfaces
                if s.room == index and (s.texture.kind == "white_paint") == is_wall and s.texture.kind in ON_WALLS
            )
            for is_wall in (True, False)
        }
        assert areas[False] < 0.3 * areas[True]


@pytest.mark.parametrize("kind", THINGS)
def test_a_thing_shows_corners_before_a_wall_that_has_nearly_none(kind: str) -> None:
    texels_per_m, bare, furnished = 400.0, [], []
    for seed in range(4):
        view = paint(TextureSpec("white_paint", seed, 1.2, 0.9, texels_per_m))
        bare.append(count_features(view))
        thing = paint(TextureSpec(kind, seed, *THINGS[kind], texels_per_m))
        view[100 : 100 + thing.shape[0], 120 : 120 + thing.shape[1]] = thing
        furnished.append(count_features(view))
    assert np.mean(bare) < 25
    assert np.mean(furnished) > np.mean(bare) + 10


@pytest.mark.parametrize("kind", THINGS)
@pytest.mark.parametrize("size_m", [(0.01, 0.01), (0.05, 0.3), (0.3, 0.03)])
def test_a_thing_of_any_size_can_be_painted_and_is_not_of_one_colour(kind: str, size_m: tuple[float, float]) -> None:
    assert np.ptp(paint(TextureSpec(kind, 1, *size_m, 400.0))) > 0


@pytest.mark.parametrize("seed", range(8))
def test_twin_rooms_differ_only_in_their_pictures(seed: int) -> None:
    world = make_world("plain", seed, TWINS)
    first, second = twin_indices(world)
    assert seen_in(world, first) == seen_in(world, second)
    pictures = [
        {s.texture for s in world.surfaces if s.room == i and s.texture.kind == "print"} for i in (first, second)
    ]
    assert not pictures[0] & pictures[1]


@pytest.mark.parametrize("seed", range(40))
def test_every_door_is_free_and_every_room_can_be_reached(seed: int) -> None:
    world = make_world("plain", seed, TWINS if seed % 2 else None)
    boxes, space = CollisionBoxes(world), FreeSpace(world, BodyParameters().radius_m)
    assert boxes.clearance(np.array([[d.x_m, d.y_m] for d in world.doors])).min() > 0.35
    assert all(len(space.free_points_in(room)) > 100 for room in world.rooms)
    assert boxes.clearance(np.array([world.start[:2]]))[0] > BodyParameters().radius_m


@pytest.mark.parametrize("seed", range(4))
def test_the_driver_drives_the_mapping_route_to_its_end_through_every_room(seed: int) -> None:
    world = make_world("plain", seed)
    route = plan_route(world, "mapping")
    body = Body(world, BodyParameters(), (*route.points[0], route.start_yaw_rad), seed)
    driver, state, ticks, blocked, visited = RouteDriver(route), body.state(), 0, 0, set[str]()
    while not driver.is_done and ticks * TICK_S < 300:
        if ticks % 15 == 0:
            command = driver.command(*body.pose, float(state.omega_body[2]))
            body.command(command.linear_m_s, command.angular_rad_s)
            visited.add(world.room_at(*body.pose[:2]))
        state = body.step()
        ticks += 1
        blocked += body.is_blocked
    assert driver.is_done
    assert blocked * TICK_S < 0.5
    assert visited - {""} == {room.name for room in world.rooms}


def test_moved_things_move_and_furniture_does_not() -> None:
    before, after = make_world("plain", 3), make_world("plain", 3, SimulationConfig(moved_chairs_seed=1))
    heavy = {"bed", "sofa", "kitchen row", "wall", "radiator"}
    kept = [[o for o in w.obstacles if o.name in heavy] for w in (before, after)]
    assert kept[0] == kept[1]
    assert before.obstacles != after.obstacles


def test_other_light_changes_no_geometry() -> None:
    before, after = make_world("plain", 3), make_world("plain", 3, SimulationConfig(light_seed=1))
    assert before.surfaces == after.surfaces and before.obstacles == after.obstacles
    assert np.ptp(after.room_light) > 0.05


def test_a_lamp_makes_a_pool_of_light_that_falls_off_as_lambert_says() -> None:
    paint_only = TextureSpec("white_ceiling", 0, 3.0, 2.0, 200.0)
    wall = Surface((0.0, 0.0, 2.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), 3.0, 2.0, paint_only)
    normal = wall.normal
    lamp = Lamp(0, (1.0, float(0.6 * normal[1]), 1.2), 0.5)
    behind = Lamp(0, (1.0, float(-0.6 * normal[1]), 1.2), 0.5)
    elsewhere = Lamp(1, lamp.p_world, 0.5)
    (glow,) = lit(wall, [lamp, behind, elsewhere], 0.2).texture.glows
    assert (glow.u_m, glow.v_m, glow.distance_m) == pytest.approx((1.0, 0.8, 0.6))
    painted, bare = (paint(spec).mean(axis=2) for spec in (lit(wall, [lamp], 0.2).texture, paint_only))
    for off_m in (0.0, 0.5, 1.2):
        patch = np.s_[150:170, int(200 * (1.0 + off_m)) - 10 : int(200 * (1.0 + off_m)) + 10]
        expected = 0.2 + 0.5 * 0.6 / math.hypot(off_m, 0.6, LAMP_SIZE_M) ** 3
        assert painted[patch].mean() / bare[patch].mean() == pytest.approx(min(expected, 255 / bare.mean()), rel=0.05)
