"""What sights and the body's way say of planes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import yaw_rotation
from station.places.rooms.axes import turn_to_rooms
from station.places.rooms.surfaces import LINE_M, PASSED, PIECE_M, SHORT_OF, Seen, find_surfaces
from station.places.rooms.wall_model import wall_model
from tests.support.flats import DOOR, TWO_ROOMS, WAY_OF_TWO, navigate

LEVEL = np.eye(3)


def lengths(seen: Seen) -> np.ndarray:
    return np.hypot(*(seen.sights[:, 2:] - seen.sights[:, :2]).T)


def test_a_sight_ends_two_sigma_before_its_landmark() -> None:
    flat = navigate(TWO_ROOMS, WAY_OF_TWO)
    sigma_m = 0.25
    cov = np.broadcast_to(sigma_m**2 * np.eye(3), flat.landmarks.cov_world.shape)
    sure = lengths(Seen.of(flat, LEVEL))
    unsure = lengths(Seen.of(replace(flat, landmarks=replace(flat.landmarks, cov_world=cov)), LEVEL))
    far = sure > 3.0  # lengths on the ground are nearly those in space
    landmark_away = (sure[far] + SHORT_OF[1]) / SHORT_OF[0]
    nearer = landmark_away - 2 * sigma_m - SHORT_OF[1]
    assert np.median(np.abs(unsure[far] - nearer)) < 0.01
    assert (unsure[far] <= nearer + 0.1).all()  # of the second farthest, which may be another now


def test_no_wall_is_where_the_body_was_nor_as_far_beside_it_as_it_is_wide() -> None:
    surfaces = find_surfaces(Seen.of(navigate(TWO_ROOMS, WAY_OF_TWO), LEVEL))
    assert surfaces is not None
    classes = surfaces.classes[0, 1]
    plane = round((DOOR[0] - surfaces.low[0]) / LINE_M)
    along = surfaces.low[1] + (np.arange(classes.shape[1]) + 0.5) * PIECE_M
    passed = along[classes[plane] == PASSED]
    assert abs(passed.min() - (DOOR[1] - 0.2)) <= PIECE_M and abs(passed.max() - (DOOR[1] + 0.2)) <= PIECE_M
    beyond_its_end = round((WAY_OF_TWO[-1][0] + 0.15 - surfaces.low[0]) / LINE_M)
    assert (classes[beyond_its_end] == PASSED).any() and not (classes[beyond_its_end + 3] == PASSED).any()


@pytest.mark.parametrize("degrees", [-3.4, 0.0, 2.6])
def test_axes_turn_to_where_rooms_are_the_likeliest(degrees: float) -> None:
    seen = Seen.of(navigate(TWO_ROOMS, WAY_OF_TWO), yaw_rotation(np.radians(degrees)))
    assert np.degrees(turn_to_rooms(seen, wall_model())) == pytest.approx(-degrees, abs=0.4)
