"""The feet of bare walls in pictures: a wall that shows no landmark, and a line on the floor that is no wall."""

from __future__ import annotations

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from shared.geometry import FloatArray, se3
from station.model.navigation import Navigation
from station.places.rooms.feet import UNSEEN, floor_height, with_feet
from station.places.rooms.surfaces import LINE_M, PIECE_M, Seen, Side, Surfaces, find_surfaces
from station.places.rooms.wall_model import wall_model
from tests.support.flats import moved
from tests.support.rooms import CAMERA, mapped

HEIGHT_M = 0.25  # of the cameras
WALL_X, LINE_X = 2.4, 1.7  # a bare wall, and before it a line on the floor
TOWARDS_WALL: Side = (0, -1)  # seen from smaller x
CELL_M = 0.1  # of the floor's pattern
UPSIDE_DOWN = se3(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def brightness(eye: FloatArray, rays: FloatArray) -> FloatArray:
    """(...) of rays (..., 3) from an eye at HEIGHT_M above a patterned floor, up to a bare wall."""
    to_wall = (WALL_X - eye[0]) / np.maximum(rays[..., 0], 1e-9)
    to_floor = np.where(rays[..., 2] < 0, HEIGHT_M / np.maximum(-rays[..., 2], 1e-9), np.inf)
    reach = np.minimum(to_wall, to_floor)[..., None]
    x, y = np.moveaxis((eye + reach * rays)[..., :2], -1, 0)
    pattern = np.random.default_rng(0).integers(-25, 26, (200, 200))
    at = pattern[(np.floor(x / CELL_M).astype(int)) % 200, (np.floor(y / CELL_M).astype(int)) % 200]
    return np.asarray(np.where(to_floor < to_wall, 70.0 + 60.0 * (x > LINE_X) + at, 200.0))


def picture(T_world_cam: FloatArray) -> bytes:
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    grey = brightness(T_world_cam[:3, 3], rays @ T_world_cam[:3, :3].T)
    grey += np.random.default_rng(2).normal(0.0, 3.0, grey.shape)
    return cv2.imencode(".png", grey.astype(np.uint8))[1].tobytes()


@functools.cache
def before_a_bare_wall(*, is_upside_down: bool = False) -> Navigation:
    """Cameras that look at it from 2 m on; landmarks are on the floor, and on a thing at the side."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 0.4, 3), np.linspace(-0.5, 0.5, 7)))
    floor = np.column_stack(
        [np.random.default_rng(1).uniform([1.3, -0.5], [2.3, 0.5], (300, 2)), np.full(300, -HEIGHT_M)]
    )
    thing = np.column_stack([np.full(300, 2.0), np.full(300, 0.5), np.linspace(-0.2, 1.0, 300)])
    navigation = mapped(np.column_stack([x, y]), 0.1 * np.sin(7.0 * y), np.concatenate([floor, thing])).navigation
    T = navigation.keyframes.T_world_cam @ (UPSIDE_DOWN if is_upside_down else np.eye(4))
    return replace(
        navigation,
        keyframes=replace(navigation.keyframes, T_world_cam=T, encoded=tuple(picture(pose) for pose in T)),
    )


def seen(navigation: Navigation) -> Surfaces:
    surfaces = find_surfaces(Seen.of(navigation, np.eye(3)))
    assert surfaces is not None
    return with_feet(surfaces, navigation, np.eye(3))


def odds(surfaces: Surfaces, side: Side, x: float) -> FloatArray:
    """(pieces,) of the foot of a wall at x, where cameras look."""
    assert surfaces.feet is not None
    plane = round((x - surfaces.low[0]) / LINE_M)
    begin, end = np.round((np.array([-0.4, 0.4]) - surfaces.low[1]) / PIECE_M).astype(int)
    return np.array(wall_model().foot)[surfaces.feet[side][plane, begin:end]]


@pytest.mark.parametrize("is_upside_down", [False, True])
def test_a_bare_wall_has_a_foot_and_a_line_on_the_floor_has_none(is_upside_down: bool) -> None:
    surfaces = seen(before_a_bare_wall(is_upside_down=is_upside_down))
    assert np.median(odds(surfaces, TOWARDS_WALL, WALL_X)) > 3.0
    assert np.median(odds(surfaces, TOWARDS_WALL, LINE_X)) < 1.0
    assert np.median(odds(surfaces, TOWARDS_WALL, 2.0)) < 0.0  # bare floor


def test_nobody_saw_a_wall_from_behind() -> None:
    feet = seen(before_a_bare_wall()).feet
    assert feet is not None and (feet[0, 1] == UNSEEN).all()


def test_where_nobody_knows_the_floor_or_no_picture_can_be_read_there_are_no_feet() -> None:
    navigation = before_a_bare_wall()
    tilted = replace(navigation, report=replace(navigation.report, gravity_aligned=False))
    above = navigation.landmarks.p_world + np.array([0.0, 0.0, 1.0])
    low = replace(navigation, landmarks=replace(navigation.landmarks, p_world=above))
    assert seen(tilted).feet is None and seen(low).feet is None
    broken = replace(navigation.keyframes, encoded=(b"", b"no picture", *navigation.keyframes.encoded[2:]))
    assert np.median(odds(seen(replace(navigation, keyframes=broken)), TOWARDS_WALL, WALL_X)) > 1.0
    feet = seen(replace(navigation, keyframes=replace(broken, encoded=(b"",) * len(broken)))).feet
    assert feet is not None and (feet[TOWARDS_WALL] == UNSEEN).all()


def test_the_floor_is_where_most_of_the_lowest_landmarks_are_as_high() -> None:
    navigation = before_a_bare_wall()
    height = floor_height(navigation, np.eye(3))
    assert height == pytest.approx(-HEIGHT_M, abs=0.001)
    lifted = moved(navigation, se3(np.eye(3), np.array([3.0, 0.0, 7.0])))
    assert floor_height(lifted, np.eye(3)) == pytest.approx(7.0 - HEIGHT_M, abs=0.001)
