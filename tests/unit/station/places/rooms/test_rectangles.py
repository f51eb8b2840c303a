"""Rooms as rectangles: the best set of them, how sure it is, and which of them are one room."""

from __future__ import annotations

import functools

import numpy as np

from station.places.rooms.borders import find_borders, settled
from station.places.rooms.plan import make_floor_plan
from station.places.rooms.rectangles import Packed, Rectangle, find_rectangles
from station.places.rooms.sides import Sides, weigh_sides
from station.places.rooms.surfaces import LINE_M, Seen, Surfaces, find_surfaces
from station.places.rooms.wall_model import wall_model
from tests.support.flats import DOOR, ELL, TWO_ROOMS, WAY_OF_ELL, WAY_OF_TWO, Wall, navigate


@functools.cache
def packed(walls: tuple[Wall, ...], way: tuple[tuple[float, float], ...]) -> tuple[Surfaces, Sides, Packed]:
    surfaces = find_surfaces(Seen.of(navigate(walls, way), np.eye(3)))
    assert surfaces is not None
    sides = weigh_sides(surfaces, wall_model())
    return surfaces, sides, find_rectangles(surfaces, sides, wall_model())


def test_two_rooms_are_two_rectangles_on_their_walls() -> None:
    surfaces, _, found = packed(TWO_ROOMS, WAY_OF_TWO)
    edges = settled(found.rectangles, surfaces)
    assert np.abs(edges - [[0.0, 4.0, 0.0, 4.0], [4.1, 8.1, 0.0, 4.0]]).max() < 0.03


def test_no_two_rectangles_lie_over_each_other() -> None:
    _, _, found = packed(ELL, WAY_OF_ELL)
    for a in found.rectangles:
        for b in found.rectangles:
            width = min(a.x1, b.x1) - max(a.x0, b.x0)
            height = min(a.y1, b.y1) - max(a.y0, b.y0)
            assert a == b or min(width, height) * LINE_M <= 0.5


def test_a_wall_with_a_door_parts_two_rooms_and_an_open_side_does_not() -> None:
    surfaces, sides, found = packed(TWO_ROOMS, WAY_OF_TWO)
    borders = find_borders(found.rectangles, settled(found.rectangles, surfaces), surfaces, sides, wall_model())
    assert not borders.joined
    (door,) = borders.passages
    assert np.abs(door.ends.mean(axis=0) - DOOR).max() < 0.1
    surfaces, sides, found = packed(ELL, WAY_OF_ELL)
    borders = find_borders(found.rectangles, settled(found.rectangles, surfaces), surfaces, sides, wall_model())
    assert len(borders.joined) >= len(found.rectangles) - 1


def test_a_room_is_as_sure_as_its_set_is_ahead_of_the_best_one_without_it() -> None:
    _, _, found = packed(TWO_ROOMS, WAY_OF_TWO)
    assert min(found.lead) > 0.0
    whole = make_floor_plan(navigate(TWO_ROOMS, WAY_OF_TWO), ())
    assert all(0.5 < room.certainty <= 1.0 for room in whole.rooms)
    least = 1.0 / (1.0 + np.exp(-min(found.lead) / wall_model().lead))
    assert min(room.certainty for room in whole.rooms) <= least + 0.05  # borders may leave more doubt


def test_overlap_is_that_of_areas() -> None:
    assert Rectangle(0, 10, 0, 10).overlap(Rectangle(5, 15, 0, 10)) == 1 / 3
    assert Rectangle(0, 10, 0, 10).overlap(Rectangle(10, 15, 0, 10)) == 0.0
