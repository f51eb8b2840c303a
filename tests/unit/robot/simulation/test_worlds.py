"""Flats are furnished, differ from seed to seed, and change between two drives only as asked."""

import numpy as np
import pytest

from robot.simulation.body import CollisionBoxes
from robot.simulation.config import SimulationConfig
from robot.simulation.world import World
from robot.simulation.worlds import WORLD_NAMES, make_world
from shared.errors import ConfigError
from tests.support.drives.routes import twin_rooms

HUNG = 550.0  # texels per m of pictures on walls; those built into desks have fewer


def pictures(world: World, room: int) -> set[object]:
    return {
        s.texture
        for s in world.surfaces
        if s.room == room and s.texture.kind == "poster" and s.texture.texels_per_m == HUNG
    }


def looks(world: World, room: int) -> list[tuple[object, ...]]:
    """Look and place, relative to the room's corner, of everything in a room."""
    corner = np.array([world.rooms[room].x0_m, world.rooms[room].y0_m, 0.0])
    return sorted(
        (repr(s.texture), *np.round(np.array(s.origin) - corner, 5).tolist(), *np.round(s.eu, 5).tolist())
        for s in world.surfaces
        if s.room == room
    )


def furniture(world: World, room: int) -> list[tuple[str, float, float]]:
    """Names and places relative to the room's corner."""
    corner = world.rooms[room]
    return [
        (o.name, round(o.x_m - corner.x0_m, 6), round(o.y_m - corner.y0_m, 6))
        for o in world.obstacles
        if o.room == room and o.name != "wall"
    ]


def test_a_hundred_seeds_give_a_hundred_flats_of_at_least_three_furnished_rooms() -> None:
    plans = set()
    for seed in range(100):
        world = make_world("home", seed)
        assert 3 <= len(world.rooms) <= 5
        assert len({r.name for r in world.rooms}) == len(world.rooms)
        assert len(world.doors) >= len(world.rooms) - 1
        assert all(len(furniture(world, i)) >= 2 for i in range(len(world.rooms)))
        assert sum(s.texture.kind == "plain_wall" for s in world.surfaces) >= 1
        plans.add(tuple(round(v, 6) for r in world.rooms for v in (r.x0_m, r.y0_m, r.x1_m, r.y1_m)))
    assert len(plans) == 100


@pytest.mark.parametrize("name", WORLD_NAMES)
def test_the_same_seed_gives_the_same_world(name: str) -> None:
    assert make_world(name, 5) == make_world(name, 5)


def test_lookalike_rooms_differ_only_in_their_pictures() -> None:
    for seed in range(5):
        world = make_world("lookalike", seed)
        assert world.rooms[2].name == world.rooms[1].name + " 2"
        assert furniture(world, 1) == furniture(world, 2)
        assert not pictures(world, 1) & pictures(world, 2)


@pytest.mark.parametrize("name", ["lookalike", "plain"])
def test_within_identical_twins_nothing_tells_them_apart(name: str) -> None:
    config = SimulationConfig(lookalike_rooms=True, identical_twins=True)
    for seed in range(5):
        world = make_world(name, seed, config)
        first, second = (looks(world, k) for k in twin_rooms(world) or ())
        assert first == second


def test_moved_chairs_move_and_nothing_else_does() -> None:
    before = make_world("home", 3)
    after = make_world("home", 3, SimulationConfig(moved_chairs_seed=1))
    assert [r.name for r in before.rooms] == [r.name for r in after.rooms]
    movable = {"chair", "boxes", "basket"}
    fixed = [[o for o in w.obstacles if o.name not in movable] for w in (before, after)]
    assert fixed[0] == fixed[1]
    moved = [[o for o in w.obstacles if o.name in movable] for w in (before, after)]
    assert moved[0] != moved[1]


def test_changed_lights_change_no_geometry() -> None:
    before, after = make_world("home", 3), make_world("home", 3, SimulationConfig(light_seed=1))
    assert before.surfaces == after.surfaces and before.obstacles == after.obstacles
    assert len(after.room_light) == len(after.rooms) and np.ptp(after.room_light) > 0.05


def test_doors_are_open_and_walls_are_not() -> None:
    for seed in range(10):
        world = make_world("home", seed)
        boxes = CollisionBoxes(world)
        for door in world.doors:
            assert boxes.clearance(np.array([[door.x_m, door.y_m]]))[0] > 0.4
        x0, y0, x1, y1 = world.bounds()
        outside = np.array([[x0 - 0.02, (y0 + y1) / 2], [x1 + 0.02, (y0 + y1) / 2]])
        assert (boxes.clearance(outside) < 0.0).all()


def test_positions_have_the_name_of_their_room() -> None:
    world = make_world("home", 1)
    for room in world.rooms:
        assert world.room_at(*room.centre) == room.name
    assert world.room_at(-5.0, -5.0) == ""


def test_an_unknown_world_is_named() -> None:
    with pytest.raises(ConfigError, match="castle"):
        make_world("castle", 0)


@pytest.mark.parametrize("name", WORLD_NAMES)
def test_every_surface_is_covered_by_its_texture(name: str) -> None:
    for seed in range(6):
        for surface in make_world(name, seed).surfaces:
            width_px, height_px = surface.texture.size_px
            density = surface.texture.texels_per_m
            assert (surface.u0_m + surface.width_m) * density <= width_px + 2.0
            assert (surface.v0_m + surface.height_m) * density <= height_px + 2.0


def test_stickers_name_every_room_and_change_nothing_else() -> None:
    for name in ("small", "home", "plain"):
        bare, named = make_world(name, 3), make_world(name, 3, SimulationConfig(stickers=True))
        hung = named.surfaces[len(bare.surfaces) :]
        assert named.surfaces[: len(bare.surfaces)] == bare.surfaces and named.obstacles == bare.obstacles
        assert [s.texture.text.casefold() for s in hung] == [named.rooms[s.room].name.casefold() for s in hung]
        assert len({s.room for s in hung}) == len(named.rooms)
