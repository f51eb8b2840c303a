"""Floor plans of empty flats: rooms, doors, walls, what people drew, and who is who on another day."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import FloatArray, se3, sim3, transform, yaw_rotation
from station.model.floor_plan import FloorPlan, PlanEdits
from station.model.navigation import Navigation
from station.model.place_map import Place, PlaceMap
from station.places.rooms.axes import TURNS, turn_to_walls
from station.places.rooms.belonging import rooms_of_places
from station.places.rooms.edits import require_plan, with_door_erased
from station.places.rooms.plan import make_floor_plan
from station.places.rooms.surfaces import Seen
from station.places.rooms.wall_model import wall_model
from station.places.tracking.map_view import MapView
from tests.support.flats import DOOR, ELL, TWO_ROOMS, WAY_OF_ELL, WAY_OF_TWO, Wall, moved, navigate

LEFT, RIGHT = np.array([[1.0, 3.0, 0.0]]), np.array([[7.0, 1.0, 0.0]])


@functools.cache
def two_rooms() -> Navigation:
    return navigate(TWO_ROOMS, WAY_OF_TWO)


@functools.cache
def plan_of_two() -> FloorPlan:
    return make_floor_plan(two_rooms(), ())


def on_ground(plan: FloorPlan, *p: tuple[float, float]) -> FloatArray:
    """Positions of the map (n, 2) in the plan's axes."""
    return (np.column_stack([np.array(p), np.zeros(len(p))]) @ plan.R_ground_map.T)[:, :2]


def test_two_rooms_behind_a_door_are_two_named_in_the_order_of_entering() -> None:
    plan = plan_of_two()
    assert [room.name for room in plan.rooms] == ["Room 1", "Room 2"]
    assert plan.rooms_at(LEFT).tolist() == [0] and plan.rooms_at(RIGHT).tolist() == [1]
    assert [room.area for room in plan.rooms] == pytest.approx([16.0, 16.0], rel=0.1)
    assert plan.rooms_at(np.array([[20.0, 1.0, 0.0], [-400.0, 0.0, 0.0]])).tolist() == [-1, -1]


def test_the_door_is_where_it_is_and_as_wide() -> None:
    (door,) = plan_of_two().doors
    assert door.ends.mean(axis=0) == pytest.approx(on_ground(plan_of_two(), DOOR)[0], abs=0.15)
    assert door.width == pytest.approx(0.9, abs=0.2)
    assert set(door.rooms) == {room.id for room in plan_of_two().rooms}


@functools.cache
def looked_into() -> PlaceMap:
    """The left room; nobody went through its door, behind which a wall is to be seen."""
    walls = [*(wall for wall in TWO_ROOMS if max(wall[0][0], wall[1][0]) <= 4.1), ((6.0, 1.0), (6.0, 3.0))]
    navigation = navigate(walls, ((1.0, 2.8), (1.5, 1.0), (3.2, 1.2), (3.2, 2.7)))
    return PlaceMap("m", "", navigation, (), (), {}, plan=make_floor_plan(navigation, ()))


def test_a_door_that_nobody_went_through_leads_out_and_is_where_it_is() -> None:
    plan = require_plan(looked_into())
    (door,) = plan.doors
    assert door.rooms == (plan.rooms[0].id, None)
    assert door.ends.mean(axis=0) == pytest.approx(on_ground(plan, DOOR)[0], abs=0.15)
    assert door.width == pytest.approx(0.9, abs=0.2)


def test_room_and_map_end_at_a_door_that_nobody_went_through() -> None:
    plan, view = require_plan(looked_into()), MapView.of(looked_into())
    within, beyond = np.array([[3.7, 1.95, 0.1]]), np.array([[4.35, 1.95, 0.1]])
    assert plan.rooms_at(within).tolist() == [0] and plan.rooms_at(beyond).tolist() == [-1]
    assert view.space.knows(within).all() and not view.space.knows(beyond).any()
    without_plan = MapView.of(replace(looked_into(), plan=None))
    assert without_plan.space.knows(beyond).all(), "a disc as wide as a passage comes so far into a door"


def test_a_way_out_that_is_none_is_erased_and_the_map_in_use_goes_on_behind_it() -> None:
    plan, view = require_plan(looked_into()), MapView.of(looked_into())
    erased = with_door_erased(looked_into(), plan.doors[0].id)
    beyond = np.array([[4.35, 1.95, 0.1]])
    assert not require_plan(erased).doors
    assert not view.space.knows(beyond).any() and view.regrouped(erased).reach.knows(beyond).all()
    assert not view.regrouped(erased).regrouped(looked_into()).reach.knows(beyond).any()


@pytest.mark.parametrize("x", [2.2, 2.6])
def test_a_way_out_is_of_the_part_of_a_room_that_it_is_in(x: float) -> None:
    before = require_plan(looked_into())
    line = on_ground(before, (x, -0.2), (x, 4.2))
    parted = make_floor_plan(looked_into().navigation, (), PlanEdits(doors_drawn=(line,)), before)
    (door,) = [door for door in parted.doors if door.rooms[1] is None]
    beside = parted.rooms[int(parted.rooms_at(np.array([[3.5, 1.95, 0.0]]))[0])]
    assert door.rooms[0] == beside.id
    assert len(parted.rooms) == 2


def test_a_niche_is_no_way_out() -> None:
    walls: list[Wall] = [
        ((0.0, 0.0), (4.0, 0.0)), ((0.0, 9.0), (4.0, 9.0)), ((0.0, 0.0), (0.0, 9.0)),
        ((4.0, 0.0), (4.0, 4.0)), ((4.0, 5.0), (4.0, 9.0)), ((4.3, 4.0), (4.3, 5.0)),
    ]  # fmt: skip
    assert not make_floor_plan(navigate(walls, ((1.0, 7.8), (1.5, 4.5), (3.2, 4.2), (2.2, 1.5))), ()).doors


def test_a_door_that_was_passed_is_no_way_out() -> None:
    assert all(door.rooms[1] is not None for door in plan_of_two().doors)


def test_walls_run_where_landmarks_line_up() -> None:
    plan = plan_of_two()
    middles = plan.walls.mean(axis=1) @ plan.R_ground_map[:2, :2]
    to_wall = np.minimum(
        np.abs(middles[:, None, 0] - [0.0, 4.0, 4.1, 8.1]).min(axis=1), np.abs(middles[:, None, 1] - [0, 4]).min(axis=1)
    )
    assert len(plan.walls) >= 8
    assert np.median(to_wall) < 0.03


def test_an_l_shaped_room_is_one_room_without_its_missing_corner() -> None:
    plan = make_floor_plan(navigate(ELL, WAY_OF_ELL), ())
    assert len(plan.rooms) == 1 and not plan.doors
    assert plan.rooms[0].area == pytest.approx(18.75, rel=0.1)
    assert plan.rooms_at(np.array([[4.0, 4.0, 0.0]])).tolist() == [-1]


@pytest.mark.parametrize("turn_deg", [-1.3, 0.25, 2.8])
def test_axes_lie_along_walls_to_a_tenth_of_a_degree(turn_deg: float) -> None:
    askew = Seen.of(two_rooms(), np.eye(3)).turned(np.radians(turn_deg))
    assert np.degrees(turn_to_walls(askew, wall_model())) == pytest.approx(-turn_deg, abs=0.1)


def test_without_a_wall_the_axes_stay() -> None:
    nothing = Seen(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 4)), np.zeros((0, 2)))
    whole = Seen.of(two_rooms(), np.eye(3))
    for seen in (nothing, replace(whole, path=np.vstack([whole.path, whole.path + 5000.0]))):  # a drive through a town
        assert turn_to_walls(seen, wall_model()) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_what_is_no_wall_turns_the_axes_by_a_few_degrees_at_most(seed: int) -> None:
    plant = np.random.default_rng(seed).normal([2.0, 0.3], 0.08, (60, 2))
    sights = np.column_stack([np.zeros_like(plant), 0.95 * plant])
    seen = Seen(plant, -plant, sights, np.column_stack([np.linspace(-1.0, 1.0, 9), np.zeros(9)]))
    assert abs(turn_to_walls(seen, wall_model())) <= TURNS[-1]


@pytest.mark.parametrize("yaw", [0.3, 1.2, -2.5])
def test_a_turned_flat_has_the_same_rooms_turned(yaw: float) -> None:
    T = se3(yaw_rotation(yaw), np.array([3.0, -20.0, 0.0]))
    plan = make_floor_plan(moved(two_rooms(), T), ())
    assert [room.area for room in plan.rooms] == pytest.approx([room.area for room in plan_of_two().rooms], rel=0.05)
    assert plan.rooms_at(transform(T, LEFT)).tolist() == [0] and plan.rooms_at(transform(T, RIGHT)).tolist() == [1]
    assert len(plan.doors) == 1


def test_lengths_follow_a_scale_that_nobody_knows() -> None:
    unknown = replace(two_rooms(), report=replace(two_rooms().report, scale="arbitrary"))
    plan, larger = make_floor_plan(unknown, ()), make_floor_plan(moved(unknown, sim3(7.0, np.eye(3), np.zeros(3))), ())
    assert len(plan.rooms) == len(larger.rooms)
    assert larger.unit == pytest.approx(7 * plan.unit)
    assert larger.rooms[0].area == pytest.approx(49 * plan.rooms[0].area, rel=0.05)


def test_the_same_arguments_give_the_same_plan() -> None:
    again = make_floor_plan(two_rooms(), ())
    assert [room.id for room in again.rooms] == [room.id for room in plan_of_two().rooms]
    assert np.array_equal(again.room, plan_of_two().room) and np.array_equal(again.walls, plan_of_two().walls)


def test_a_drawn_line_parts_a_room_and_the_larger_part_keeps_the_name() -> None:
    before = plan_of_two()
    line = on_ground(before, (-0.5, 1.4), (4.05, 1.4))
    plan = make_floor_plan(two_rooms(), (), PlanEdits(doors_drawn=(line,)), before)
    assert len(plan.rooms) == 3
    assert plan.rooms[int(plan.rooms_at(LEFT)[0])].id == before.rooms[0].id
    small = plan.rooms[int(plan.rooms_at(np.array([[1.0, 0.7, 0.0]]))[0])]
    assert small.name == "Room 3" and small.id not in {room.id for room in before.rooms}
    (drawn,) = [door for door in plan.doors if door.is_drawn]
    assert np.array_equal(drawn.ends, line) and set(drawn.rooms) == {small.id, before.rooms[0].id}


def test_an_erased_door_joins_its_rooms() -> None:
    before = plan_of_two()
    plan = make_floor_plan(two_rooms(), (), PlanEdits(doors_erased=(before.doors[0].ends,)), before)
    assert len(plan.rooms) == 1 and not plan.doors
    assert plan.rooms[0].id in {room.id for room in before.rooms}


def test_rooms_keep_id_and_name_when_the_map_moved() -> None:
    names = {plan_of_two().rooms[1].id: "Kitchen"}
    before = make_floor_plan(two_rooms(), (), PlanEdits(names=names), plan_of_two())
    assert before.rooms[1].name == "Kitchen"
    T = se3(yaw_rotation(0.7), np.array([1.0, 2.0, 0.0]))
    backwards = moved(navigate(TWO_ROOMS, WAY_OF_TWO[::-1], seed=3), T)  # enters the kitchen first
    plan = make_floor_plan(replace(backwards, id="another day"), (), previous=before, T_map_previous=T)
    assert plan.rooms[int(plan.rooms_at(transform(T, RIGHT))[0])].name == "Kitchen"
    assert {room.id for room in plan.rooms} == {room.id for room in before.rooms}


def place_of(navigation: Navigation, name: str, mask: np.ndarray) -> Place:
    p = navigation.landmarks.p_world[mask]
    return Place(name, name, p.mean(axis=0), 0.3, np.flatnonzero(mask), np.zeros(0, np.int64), -1, 1.0)


def test_of_a_wall_each_face_belongs_to_its_own_room() -> None:
    navigation = two_rooms()
    p = navigation.landmarks.p_world
    beside_door = (p[:, 1] > 2.6) & (p[:, 1] < 3.6)
    faces = {
        "near": beside_door & (np.abs(p[:, 0] - 4.0) < 0.04),
        "behind": beside_door & (np.abs(p[:, 0] - 4.1) < 0.04),
    }
    plan = make_floor_plan(navigation, [place_of(navigation, name, mask) for name, mask in faces.items()])
    assert [plan.room_of_place[name] for name in ("near", "behind")] == [room.id for room in plan.rooms]


def test_what_is_seen_through_a_door_into_what_is_no_room_belongs_to_none() -> None:
    navigation, plan = two_rooms(), plan_of_two()
    p = navigation.landmarks.p_world
    one_room = replace(plan, rooms=plan.rooms[:1], room=np.minimum(plan.room, 0) - (plan.room == 1), doors=())
    assert one_room.rooms_at(RIGHT).tolist() == [-1]
    places = [place_of(navigation, "here", p[:, 0] < 4.05), place_of(navigation, "beyond", p[:, 0] > 7.0)]
    assert rooms_of_places(one_room, navigation, places) == {"here": plan.rooms[0].id}


def test_what_is_seen_only_from_the_next_room_belongs_to_its_own() -> None:
    """The plan knows both rooms; only the keyframes of the first one observed the place in the second."""
    navigation = two_rooms()
    marks, plan = navigation.landmarks, plan_of_two()
    far = marks.p_world[:, 0] > 7.0
    from_left = plan.rooms_at(navigation.keyframes.T_world_cam[:, :3, 3])[marks.observed_keyframe] == 0
    kept = from_left | ~far[marks.observed_landmark]
    observed = replace(
        marks,
        observed_landmark=marks.observed_landmark[kept],
        observed_keyframe=marks.observed_keyframe[kept],
        observed_uv_px=marks.observed_uv_px[kept],
    )
    is_seen = far & np.isin(np.arange(len(marks)), observed.observed_landmark)
    assert is_seen.any()
    half_seen = replace(navigation, landmarks=observed)
    assert rooms_of_places(plan, half_seen, [place_of(half_seen, "far", is_seen)]) == {"far": plan.rooms[1].id}


def test_a_navigation_that_saw_nothing_has_a_plan_without_rooms() -> None:
    keyframes, landmarks = two_rooms().keyframes, two_rooms().landmarks
    nothing = replace(
        two_rooms(),
        trajectory=replace(two_rooms().trajectory, t_robot_ns=np.zeros(0, np.int64), T_world_body=np.zeros((0, 4, 4))),
        keyframes=replace(
            keyframes,
            frame_index=np.zeros(0, np.int64),
            t_robot_ns=np.zeros(0, np.int64),
            T_world_cam=np.zeros((0, 4, 4)),
            encoded=(),
            segment=np.zeros(0, np.int64),
        ),
        landmarks=replace(
            landmarks,
            p_world=np.zeros((0, 3)),
            rgb=np.zeros((0, 3), np.uint8),
            cov_world=np.zeros((0, 3, 3)),
            observed_landmark=np.zeros(0, np.int64),
            observed_keyframe=np.zeros(0, np.int64),
            observed_uv_px=np.zeros((0, 2)),
        ),
    )
    plan = make_floor_plan(nothing, ())
    assert plan.rooms == () and plan.doors == () and plan.rooms_at(LEFT).tolist() == [-1]
