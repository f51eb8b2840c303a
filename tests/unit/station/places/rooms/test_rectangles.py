"""Rooms as rectangles: the best set of them, how sure it is, and which of them are one room."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.places.rooms.borders import find_borders, wall_with_doors, walls_of
from station.places.rooms.plan import plan_along
from station.places.rooms.rectangles import Packed, Rectangle, _Choices, _packed, find_rectangles
from station.places.rooms.segments import _passed_unseen
from station.places.rooms.sides import DOOR_PIECES, PASSAGE_PIECES, Sides, passage_costs, weigh_sides
from station.places.rooms.standing import standing_sides
from station.places.rooms.surfaces import LINE_M, PIECE_M, SIDES, Seen, Surfaces
from station.places.rooms.wall_model import wall_model
from tests.support.flats import DOOR, ELL, TWO_ROOMS, WAY_OF_ELL, WAY_OF_TWO, Wall, navigate, surfaces_seen

OVERLAP_M = 0.3  # rectangles that reach over each other by as much are rivals


@functools.cache
def packed(walls: tuple[Wall, ...], way: tuple[tuple[float, float], ...]) -> tuple[Surfaces, Sides, Packed]:
    surfaces = surfaces_seen(Seen.of(navigate(walls, way), np.eye(3)))
    sides = weigh_sides(surfaces, wall_model())
    return surfaces, sides, find_rectangles(surfaces, sides, wall_model())


def test_two_rooms_are_two_rectangles_on_their_walls() -> None:
    surfaces, sides, found = packed(TWO_ROOMS, WAY_OF_TWO)
    edges = standing_sides(found.rectangles, surfaces, sides, wall_model())
    assert np.abs(edges - [[0.0, 4.0, 0.0, 4.0], [4.1, 8.1, 0.0, 4.0]]).max() < 0.03


def test_a_room_that_the_robot_only_reached_into_was_not_entered() -> None:
    _, _, found = packed(TWO_ROOMS, ((2.0, 2.0), (3.0, 1.95), (4.6, 1.95)))
    assert len(found.rectangles) == 1


def test_no_two_rectangles_lie_over_each_other() -> None:
    _, _, found = packed(ELL, WAY_OF_ELL)
    for a in found.rectangles:
        for b in found.rectangles:
            width = min(a.x1, b.x1) - max(a.x0, b.x0)
            height = min(a.y1, b.y1) - max(a.y0, b.y0)
            assert a == b or min(width, height) * LINE_M < OVERLAP_M


@pytest.mark.parametrize("begin", range(40, 50))
def test_of_two_rectangles_that_lie_over_each_other_one_is_chosen(begin: int) -> None:
    """So that no strip beside the way counts as entered by what lies over the next room."""
    surfaces, _, _ = packed(TWO_ROOMS, WAY_OF_TWO)
    end = begin + round(OVERLAP_M / LINE_M)
    score = np.full((2, 2, 1, 1), -np.inf)
    score[0, 0], score[1, 1] = 2.0, 1.0
    planes = [np.array(found) for found in ([20, begin], [end, 80], [20], [60])]
    assert _packed(_Choices(planes, score), surfaces).rectangles == (Rectangle(20, end, 20, 60),)


def test_where_the_body_was_no_plane_is_a_wall() -> None:
    """Also where landmarks lie on it: they err by more, or it drove over them."""
    along = np.linspace(-2.0, 2.0, 81)
    path = np.column_stack([along, np.full(81, 0.05)])
    p = np.column_stack([np.repeat(along, 3), np.full(243, 0.1)])
    sights = np.column_stack([np.full(81, 0.0), np.full(81, -1.0), along, np.full(81, 0.05)])
    surfaces = surfaces_seen(Seen(p, np.tile([0.0, -1.0], (243, 1)), sights, path))
    is_wall = weigh_sides(surfaces, wall_model()).is_wall[1, -1]
    planes = np.round((np.array([0.05, 0.1, 0.15]) - surfaces.low[1]) / LINE_M).astype(int)
    begin, end = np.round((np.array([-1.5, 1.5]) - surfaces.low[0]) / PIECE_M).astype(int)
    assert not is_wall[planes, begin:end].any()


def test_a_wall_with_a_door_parts_two_rooms_and_an_open_side_does_not() -> None:
    surfaces, sides, found = packed(TWO_ROOMS, WAY_OF_TWO)
    edges = standing_sides(found.rectangles, surfaces, sides, wall_model())
    borders = find_borders(found.rectangles, edges, surfaces, sides, wall_model())
    assert not borders.joined
    (door,) = borders.passages
    assert np.abs(door.ends.mean(axis=0) - DOOR).max() < 0.1
    surfaces, sides, found = packed(ELL, WAY_OF_ELL)
    edges = standing_sides(found.rectangles, surfaces, sides, wall_model())
    borders = find_borders(found.rectangles, edges, surfaces, sides, wall_model())
    assert len(borders.joined) >= len(found.rectangles) - 1


def test_no_wall_is_drawn_between_two_rectangles_that_are_one_room() -> None:
    surfaces, sides, found = packed(ELL, WAY_OF_ELL)
    edges = standing_sides(found.rectangles, surfaces, sides, wall_model())
    walls = walls_of(found.rectangles, edges, surfaces, sides, ((0, 1),))
    middles = walls.mean(axis=1)
    inside = (middles > 0.05).all(axis=1) & (middles < 2.45).any(axis=1) & (middles < 2.8).all(axis=1)
    assert len(found.rectangles) == 2 and len(walls) and not inside.any()


def test_a_border_passed_in_one_place_has_a_door_there() -> None:
    odds = np.full(30, 2.0)
    odds[12:20] = -np.inf
    nats, ((begin, end),) = wall_with_doors(odds, wall_model())
    assert nats > 0.0
    assert begin <= 12 and end >= 20


def test_an_opening_of_two_metres_in_a_wall_parts_two_rooms_and_one_as_wide_as_the_arm_of_an_ell_does_not() -> None:
    odds = np.full(42, 2.0)
    odds[12:32] = -np.inf
    nats, ((begin, end),) = wall_with_doors(odds, wall_model())
    assert nats > 0.0
    assert begin <= 12 and end >= 32
    odds[4:26] = -np.inf
    assert wall_with_doors(odds[:30], wall_model())[0] < 0.0


def test_two_doors_with_a_wall_between_are_two_doors() -> None:
    odds = np.full(90, 2.0)
    odds[10:19] = odds[60:70] = -np.inf
    nats, doors = wall_with_doors(odds, wall_model())
    assert nats > 0.0
    (first, second) = doors
    assert first[0] <= 10 and 19 <= first[1] < second[0] <= 60 and second[1] >= 70


def test_a_border_passed_in_two_places_is_an_opening_though_a_cupboard_stands_between() -> None:
    """Two doors side by side between the same rooms are none."""
    odds = np.full(30, 2.0)
    odds[3:9] = odds[13:20] = -np.inf
    assert wall_with_doors(odds, wall_model())[0] < 0.0


@pytest.mark.parametrize("x_m", [3.4, 4.1])
def test_a_door_nobody_saw_is_in_the_wall_beside_it_not_half_way_to_a_cupboards_front(x_m: float) -> None:
    surfaces, _, _ = packed(TWO_ROOMS, WAY_OF_TWO)
    k = [round((x - surfaces.low[0]) / LINE_M) for x in (0.0, 3.4, 4.1, 8.1)]
    y = [round((y - surfaces.low[1]) / LINE_M) for y in (0.0, 4.0)]
    rectangles = (Rectangle(k[0], k[1], *y), Rectangle(k[2], k[3], *y))
    edges = np.array([[0.0, 3.4, 0.0, 4.0], [4.1, 8.1, 0.0, 4.0]])
    odds = {side: np.zeros(surfaces.classes[side].shape) for side in SIDES}
    for side in SIDES[:2]:
        odds[side][round((x_m - surfaces.low[0]) / LINE_M)] = 2.0
    sides = Sides(odds, {}, {}, np.zeros((0, 0)))
    (passage,) = _passed_unseen(surfaces, sides, rectangles, edges, ())
    assert passage.ends.mean(axis=0) == pytest.approx([x_m, DOOR[1]], abs=0.05)


def test_a_path_whose_first_step_leads_into_another_room_has_a_door_there() -> None:
    seen = replace(Seen.of(navigate(TWO_ROOMS, WAY_OF_TWO), np.eye(3)), path=np.array([[3.7, DOOR[1]], [4.4, DOOR[1]]]))
    surfaces = surfaces_seen(seen)
    k = [round((x - surfaces.low[0]) / LINE_M) for x in (0.0, 4.0, 4.1, 8.1)]
    y = [round((y - surfaces.low[1]) / LINE_M) for y in (0.0, 4.0)]
    rectangles = (Rectangle(k[0], k[1], *y), Rectangle(k[2], k[3], *y))
    sides = weigh_sides(surfaces, wall_model())
    edges = standing_sides(rectangles, surfaces, sides, wall_model())
    (passage,) = _passed_unseen(surfaces, sides, rectangles, edges, ())
    assert passage.ends.mean(axis=0) == pytest.approx(DOOR, abs=0.1)


@given(st.lists(st.floats(-6.0, 4.0), min_size=1, max_size=40))
def test_walls_and_doors_are_the_best_of_all_ways(odds: list[float]) -> None:
    model = wall_model()

    def best(begin: int) -> float:
        """Of what is behind a piece, where a door may begin."""
        tried = [sum(odds[begin:])]
        for at in range(begin, len(odds)):
            for pieces, cost in zip(PASSAGE_PIECES.tolist(), passage_costs(model).tolist(), strict=True):
                if (end := at + pieces) <= len(odds):
                    rest = sum(odds[end:])
                    after = end + DOOR_PIECES[0]
                    if after < len(odds):
                        rest = max(rest, sum(odds[end:after]) + best_from[after])
                    tried.append(sum(odds[begin:at]) - cost + rest)
        return max(tried)

    best_from: dict[int, float] = {}
    for begin in reversed(range(len(odds))):
        best_from[begin] = best(begin)
    assert wall_with_doors(np.array(odds), model)[0] == pytest.approx(best_from[0], abs=1e-6)


def test_a_room_is_as_sure_as_its_set_is_ahead_of_the_best_one_without_it() -> None:
    _, _, found = packed(TWO_ROOMS, WAY_OF_TWO)
    assert min(found.lead) > 0.0
    whole = plan_along(np.eye(3), navigate(TWO_ROOMS, WAY_OF_TWO), (), wall_model())
    assert all(0.5 < room.certainty <= 1.0 for room in whole.rooms)
    least = 1.0 / (1.0 + np.exp(-min(found.lead) / wall_model().lead))
    assert min(room.certainty for room in whole.rooms) <= least + 0.05  # borders may leave more doubt


def test_overlap_is_that_of_areas() -> None:
    assert Rectangle(0, 10, 0, 10).overlap(Rectangle(5, 15, 0, 10)) == 1 / 3
    assert Rectangle(0, 10, 0, 10).overlap(Rectangle(10, 15, 0, 10)) == 0.0
