"""Where walls stand between the planes that chose them."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray
from station.places.rooms.rectangles import Rectangle, find_rectangles
from station.places.rooms.sides import Sides, weigh_sides
from station.places.rooms.standing import place_by_landmarks, place_by_planes, standing_sides, weighed
from station.places.rooms.surfaces import LINE_M, ON_M, Seen, Surfaces
from station.places.rooms.wall_model import wall_model
from tests.support.flats import navigate, surfaces_seen

METRES = st.floats(-ON_M, ON_M)
VARIANCES = st.floats(0.0, 1.0)


@functools.cache
def room(moved_m: float) -> tuple[Surfaces, Sides, tuple[Rectangle, ...]]:
    """A room of 4 x 3 m, moved along both axes."""
    a, b, c = moved_m, 4.0 + moved_m, 3.0 + moved_m
    walls = (((a, a), (b, a)), ((a, c), (b, c)), ((a, a), (a, c)), ((b, a), (b, c)))
    navigation = navigate(walls, ((1.0 + moved_m, 1.5 + moved_m), (3.0 + moved_m, 1.5 + moved_m)))
    surfaces = surfaces_seen(Seen.of(navigation, np.eye(3)))
    sides = weigh_sides(surfaces, wall_model())
    return surfaces, sides, find_rectangles(surfaces, sides, wall_model()).rectangles


@pytest.mark.parametrize("moved_m", [0.0, 0.012, 0.025, 0.038, 0.05, 0.07])
def test_walls_stand_where_they_are_however_the_planes_lie(moved_m: float) -> None:
    surfaces, sides, rectangles = room(moved_m)
    edges = standing_sides(rectangles, surfaces, sides, wall_model())
    assert np.abs(edges - moved_m - [[0.0, 4.0, 0.0, 3.0]]).max() < 0.006


@pytest.mark.parametrize("seed", range(5))
def test_what_stands_before_a_bare_wall_does_not_draw_it_forward(seed: int) -> None:
    """The same evidence of planes, but the landmarks of the wall at x = 0 lie anywhere in the 7 cm before it."""
    surfaces, sides, rectangles = room(0.0)
    p = surfaces.seen.p.copy()
    on = np.abs(p[:, 0]) < ON_M
    p[on, 0] = np.random.default_rng(seed).uniform(0.0, ON_M, int(on.sum()))
    bare = replace(surfaces, seen=replace(surfaces.seen, p=p))
    edges = standing_sides(rectangles, bare, sides, wall_model())
    assert abs(edges[0, 0]) < 0.02
    assert np.median(p[on, 0]) > 0.03


def test_a_wall_of_which_nothing_is_seen_stays_on_its_plane() -> None:
    surfaces, sides, rectangles = room(0.012)
    nobody = replace(surfaces.seen, p=np.empty((0, 2)), towards=np.empty((0, 2)))
    equal = {side: np.zeros_like(odds) for side, odds in sides.odds.items()}
    blind = replace(surfaces, seen=nobody), replace(sides, odds=equal)
    (r,) = rectangles
    planes = [surfaces.low[k // 2] + LINE_M * plane for k, plane in enumerate((r.x0, r.x1, r.y0, r.y1))]
    assert standing_sides(rectangles, *blind, wall_model())[0] == pytest.approx(planes)
    assert standing_sides((), surfaces, sides, wall_model()).shape == (0, 4)


def test_the_other_side_of_a_wall_says_nothing_of_this_one() -> None:
    surfaces, sides, rectangles = room(0.0)
    seen = surfaces.seen
    behind = np.column_stack([np.full(400, -0.06), np.linspace(0.2, 2.8, 400)])
    both = replace(
        seen,
        p=np.concatenate([seen.p, behind]),
        towards=np.concatenate([seen.towards, np.tile([-1.0, 0.0], (400, 1))]),
    )
    edges = standing_sides(rectangles, surfaces, sides, wall_model())
    assert np.array_equal(standing_sides(rectangles, replace(surfaces, seen=both), sides, wall_model()), edges)


@given(st.lists(st.tuples(METRES, VARIANCES), min_size=1, max_size=4))
def test_a_wall_stands_between_what_says_where_it_is(found: list[tuple[float, float]]) -> None:
    means = [mean for mean, _ in found]
    assert min(means) - 1e-12 <= weighed(found) <= max(means) + 1e-12


@given(METRES, METRES)
def test_what_says_nothing_does_not_count(mean: float, other: float) -> None:
    assert weighed([(mean, 0.01), (other, np.inf)]) == pytest.approx(mean)


@given(st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3))
def test_planes_say_the_same_mirrored(odds: list[float]) -> None:
    here = place_by_planes(np.array(odds)[:, None], 1, 10.0)
    there = place_by_planes(np.array(odds[::-1])[:, None], 1, 10.0)
    assert here[0] == pytest.approx(-there[0])
    assert here[1] == pytest.approx(there[1])
    assert abs(here[0]) <= LINE_M


def test_a_wall_leans_to_the_likelier_neighbour_and_never_to_where_the_body_was() -> None:
    leaning, _ = place_by_planes(np.array([[0.0], [20.0], [15.0]]), 1, 10.0)
    assert 0.0 < leaning < 0.5 * LINE_M
    barred, _ = place_by_planes(np.array([[0.0], [20.0], [-np.inf]]), 1, 10.0)
    assert -0.5 * LINE_M < barred < 0.0


@pytest.mark.parametrize(("plane", "sign"), [(0, 1), (2, -1)])
def test_the_outermost_plane_has_one_neighbour(plane: int, sign: int) -> None:
    mean, _ = place_by_planes(np.zeros((3, 4)), plane, 10.0)
    assert mean == pytest.approx(sign * 0.5 * LINE_M)


def test_landmarks_are_as_sure_as_they_lie_together() -> None:
    def variance(p: FloatArray) -> float:
        return place_by_landmarks(p)[1]

    narrow, wide = np.linspace(-0.005, 0.005, 101), np.linspace(-ON_M, ON_M, 101)
    assert variance(narrow) < 0.1 * variance(wide)
    assert variance(narrow) < variance(narrow[::20])
    assert variance(np.empty(0)) == np.inf
