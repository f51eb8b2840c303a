"""How sure a pose is that was found from a small thing: as sure as the thing's tilt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.geometry import FloatArray, inverse, median_radius, so3_exp, transform
from station.model.navigation import Landmarks
from station.model.place_answer import Localization
from station.places.tracking.image_evidence import ImageEvidence, swing
from station.places.tracking.map_view import MapView
from station.vision.camera_pose import solve_pose
from tests.support.places import CONFIG, make_map, pose, seen


def landmarks(p_world: FloatArray, sigma: float) -> Landmarks:
    n = len(p_world)
    nowhere = np.zeros(0, dtype=np.int64)
    cov = np.tile(sigma**2 * np.eye(3), (n, 1, 1))
    return Landmarks(p_world, np.zeros((n, 3), np.uint8), cov, nowhere, nowhere, np.zeros((0, 2)))


def recognised(p_world: FloatArray) -> Localization:
    """By a camera at the origin of the map."""
    return replace(
        seen(0.0, np.eye(4), landmarks=tuple(range(len(p_world))), extent=median_radius(p_world)), T_map_cam=np.eye(4)
    )


@given(
    radius=st.floats(0.1, 0.6), away=st.floats(1.0, 4.0), sigma=st.floats(0.002, 0.02), axis=st.floats(-np.pi, np.pi)
)
def test_a_thing_that_the_map_has_tilted_turns_the_camera_about_it_by_as_much(
    radius: float, away: float, sigma: float, axis: float
) -> None:
    """The camera's true pose is the origin; the map has the thing tilted by one standard deviation."""
    p_true = np.random.default_rng(0).normal(0.0, radius, (60, 3)) + np.array([0.0, 0.0, away + 2 * radius])
    middle = np.median(p_true, axis=0)
    z = recognised(p_true)
    off_m, off_rad = swing(z, landmarks(p_true, sigma))
    R = so3_exp(off_rad * np.array([np.cos(axis), np.sin(axis), 0.0]))
    tilted = (p_true - middle) @ R.T + middle
    found = solve_pose(tilted, p_true[:, :2] / p_true[:, 2:], tolerance=0.01)
    assert found is not None
    T = found.T_map_cam
    assert np.allclose(transform(inverse(T), tilted), p_true, atol=1e-3)
    assert np.linalg.norm(T[:3, 3]) == pytest.approx(off_m, rel=0.3)


def test_what_the_map_says_nothing_of_adds_nothing() -> None:
    p_world = np.random.default_rng(1).normal(0.0, 0.2, (40, 3)) + np.array([0.0, 0.0, 2.0])
    assert swing(recognised(p_world), landmarks(p_world, 0.0)) == (0.0, 0.0)
    assert swing(replace(recognised(p_world), landmarks=np.zeros(0, dtype=np.int64)), landmarks(p_world, 0.01)) == (
        0.0,
        0.0,
    )


def test_a_pose_from_a_small_thing_is_less_sure_in_place_and_heading() -> None:
    place_map = make_map()
    spots = place_map.navigation.landmarks
    unsure = replace(spots, cov_world=np.tile(0.01**2 * np.eye(3), (len(spots), 1, 1)))
    place_map = replace(place_map, navigation=replace(place_map.navigation, landmarks=unsure))
    evidence = ImageEvidence([MapView.of(place_map)], None, CONFIG)
    small, large = (evidence.measured(seen(0.0, pose(0.0, 0.0), landmarks=(0, 1, 2), extent=e)) for e in (0.1, 1.0))
    assert small.sigma_rad == pytest.approx(np.hypot(CONFIG.pose_floor_rad, 0.1), rel=1e-6)
    assert small.sigma_m > 2 * large.sigma_m and small.sigma_rad > 2 * large.sigma_rad
