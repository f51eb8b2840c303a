"""Routes cut into straight sections."""

import numpy as np
import pytest

from shared.geometry import FloatArray
from station.experiments.routes import find_sections


def along(*corners: tuple[float, float], step: float = 0.02) -> FloatArray:
    """(N, 2) positions of a robot that drives from corner to corner."""
    pieces = []
    for a, b in zip(np.array(corners[:-1]), np.array(corners[1:]), strict=True):
        steps = round(float(np.linalg.norm(b - a)) / step)
        pieces.append(a + (b - a) * np.arange(steps)[:, None] / steps)
    return np.concatenate([*pieces, np.array(corners[-1:])])


def test_a_rectangle_has_four_sides_and_three_right_turns_to_the_left() -> None:
    route = find_sections(along((0, 0), (3, 0), (3, 2), (0, 2), (0, 0)))
    np.testing.assert_allclose(route.length, [3, 2, 3, 2], atol=0.05)
    np.testing.assert_allclose(route.turn_deg, [90, 90, 90], atol=2)


def test_a_turn_to_the_right_is_negative() -> None:
    np.testing.assert_allclose(find_sections(along((0, 0), (2, 0), (2, -2))).turn_deg, [-90], atol=2)


def test_a_rounded_corner_is_one_corner_in_the_middle_of_its_bend() -> None:
    bend = np.array([[2 + 0.4 * np.sin(a), 0.4 - 0.4 * np.cos(a)] for a in np.linspace(0, np.pi / 2, 30)])
    route = find_sections(np.concatenate([along((0, 0), (2, 0)), bend, along((2.4, 0.4), (2.4, 2.4))]))
    assert len(route.length) == 2
    np.testing.assert_allclose(route.length, 2 + 0.1 * np.pi, atol=0.06)


def test_standing_still_adds_no_length() -> None:
    rng = np.random.default_rng(0)
    drive = along((0, 0), (2, 0))
    rest = drive[50] + rng.normal(0, 0.001, (2000, 2))
    route = find_sections(np.concatenate([drive[:51], rest, drive[50:]]))
    assert route.length.sum() == pytest.approx(2.0, abs=0.02)


def test_a_path_that_winds_is_one_section_with_round_marks() -> None:
    t = np.linspace(0, 12 * np.pi, 3000)
    route = find_sections(np.column_stack([np.cos(t), np.sin(t)]))
    assert len(route.length) == 1 and route.length[0] == pytest.approx(12 * np.pi, rel=0.01)
    distance, at = route.marks()
    np.testing.assert_array_equal(distance, [10, 20, 30])
    np.testing.assert_allclose(np.linalg.norm(at, axis=1), 1.0, atol=0.01)


def test_a_robot_that_never_moved_has_a_route_of_no_length() -> None:
    for position in (np.zeros((1, 2)), np.zeros((5, 2))):
        route = find_sections(position)
        assert route.length.sum() == 0 and len(route.turn_deg) == 0 and len(route.marks()[0]) == 0
