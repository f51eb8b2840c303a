"""A map's space, wider by what recognised images saw through: in the open, and not back through a door."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, se3, transform, yaw_rotation
from station.model.navigation import Navigation
from station.places.space.space import Space
from station.places.space.widened import WidenedSpace
from tests.support.rooms import DOOR, WALL_X, mapped, room_with_a_door, walls
from tests.unit.station.places.space.test_space import moved

EYE = np.array([2.6, 3.2, 0.0])  # in the room, beside all that a drive along its middle has seen
AWAY = np.array([3.6, 3.8, 0.0])  # farther on, behind that eye


def along_the_middle() -> Navigation:
    x = np.linspace(0.3, 1.2, 20)
    return mapped(np.column_stack([x, np.full(20, 2.0)]), np.zeros(20), walls()).navigation


def driven_along_the_middle() -> Space:
    return Space.of(along_the_middle())


def seen_from(eye: FloatArray, towards_deg: float, half_deg: float) -> FloatArray:
    """Landmarks of this room (n, 3) that a camera sees."""
    p = walls()[walls()[:, 0] < WALL_X]
    d = p[:, :2] - eye[:2]
    off = (np.degrees(np.arctan2(d[:, 1], d[:, 0])) - towards_deg + 180) % 360 - 180
    through = eye[1] + d[:, 1] * (WALL_X - eye[0]) / np.where(d[:, 0] == 0, 1e-9, d[:, 0])
    is_open = (eye[0] < WALL_X) | ((through > DOOR[0]) & (through < DOOR[1]))
    return p[(np.abs(off) < half_deg) & is_open]


def test_in_the_open_where_no_mapping_camera_looked_what_surrounds_an_image_makes_its_spot_known() -> None:
    space = WidenedSpace.of(driven_along_the_middle())
    assert not space.knows(EYE[None]).any()
    wider = space.looking(EYE, seen_from(EYE, -150, 45))
    assert wider.knows(EYE[None]).all() and not wider.knows(AWAY[None]).any()
    assert not space.knows(EYE[None]).any(), "the one before stays as it was"


def test_a_narrow_look_does_not() -> None:
    space = WidenedSpace.of(driven_along_the_middle())
    assert space.looking(EYE, seen_from(EYE, -150, 8)) is space


@pytest.mark.parametrize("beyond_m", [1.6, 2.0, 3.0])
def test_who_looks_back_through_a_door_stays_beyond_it(beyond_m: float) -> None:
    eye = np.array([WALL_X + beyond_m, 2.0, 0.0])
    seen = seen_from(eye, 180, 45)
    assert len(seen) > 50
    space = WidenedSpace.of(Space.of(room_with_a_door().navigation))
    for step in np.linspace(0, 0.5, 6):  # images from several places add up to no wider door
        eye = np.array([WALL_X + beyond_m, 1.75 + step, 0.0])
        space = space.looking(eye, seen_from(eye, 180, 45))
        assert not space.knows(eye[None]).any()


def test_an_image_that_recognised_nothing_or_was_taken_far_away_changes_nothing() -> None:
    space = WidenedSpace.of(driven_along_the_middle())
    assert space.looking(EYE, np.empty((0, 3))) is space
    assert space.looking(np.array([500.0, 0.0, 0.0]), seen_from(EYE, -150, 45)) is space


def test_wherever_the_map_lies_the_same_becomes_known() -> None:
    navigation, seen = along_the_middle(), seen_from(EYE, -150, 45)
    T = se3(yaw_rotation(0.5 * np.pi), np.array([3.0, -20.0, 5.0]))
    here = WidenedSpace.of(Space.of(navigation)).looking(EYE, seen)
    there = WidenedSpace.of(Space.of(moved(navigation, T, navigation.report)))
    there = there.looking(transform(T, EYE), transform(T, seen))
    spots = EYE + np.array([[0.0, 0.0, 0.0], [1.0, 0.6, 0.0], [-0.4, -0.3, 0.0]])
    assert there.knows(transform(T, spots)).tolist() == here.knows(spots).tolist() == [True, False, True]
