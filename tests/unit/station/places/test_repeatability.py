"""How surely a place would be found again: clear groups surely, arbitrary ones not."""

from dataclasses import replace

import numpy as np
import pytest

from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.making.build import build_map
from station.places.making.config import PlacesConfig, ThesisConfig
from station.places.making.repeatability import _chosen, repeatability
from tests.support.synthetic_home import drive, furnished_room, navigate, with_points


@pytest.fixture(scope="module")
def navigation() -> Navigation:
    home = furnished_room(3, density=300)
    return navigate(home, drive(home, 31, frames=30), seed=31, images=False)


def in_blobs(navigation: Navigation) -> Navigation:
    """The same landmarks, in four tight groups three metres apart."""
    rng = np.random.default_rng(0)
    count = len(navigation.landmarks)
    blob = np.arange(count) % 4
    return with_points(
        navigation, np.c_[3.0 * blob, 2.0 * (blob % 2), np.zeros(count)] + rng.normal(0, 0.1, (count, 3))
    )


@pytest.mark.parametrize("config", [PlacesConfig(), PlacesConfig(mode="thesis", thesis=ThesisConfig(eps=0.2))])
def test_groups_far_apart_are_found_again_and_parts_of_them_are_not(
    navigation: Navigation, config: PlacesConfig
) -> None:
    place_map = build_map(in_blobs(navigation), config=config)
    assert len(place_map.places) == 4
    assert repeatability(place_map).min() > 0.97
    first, second, *_ = place_map.places
    half = first.landmark_index[: len(first.landmark_index) // 2]
    across = np.concatenate([half, second.landmark_index[: len(half)]])
    arbitrary = replace(place_map, places=(replace(first, landmark_index=half), replace(second, landmark_index=across)))
    assert repeatability(arbitrary).max() < 0.6


def test_the_same_map_and_seed_give_the_same_figures_and_none_without_places(navigation: Navigation) -> None:
    place_map = build_map(navigation)
    shares = repeatability(place_map)
    assert len(shares) == len(place_map.places) and ((shares >= 0) & (shares <= 1)).all()
    assert np.array_equal(shares, repeatability(place_map)) and not np.array_equal(
        shares, repeatability(place_map, seed=1)
    )
    nothing = build_map(with_points(navigation, np.zeros((0, 3))))
    assert repeatability(nothing).shape == (0,)


def test_a_map_that_says_nothing_of_its_making_is_measured_too(navigation: Navigation) -> None:
    place_map: PlaceMap = replace(build_map(in_blobs(navigation)), config={"older": "word"})
    assert repeatability(place_map).min() > 0.97


def test_landmarks_drawn_twice_bring_their_observations_twice(navigation: Navigation) -> None:
    landmarks = navigation.landmarks
    drawn = np.array([0, 5, 5, len(landmarks) - 1])
    chosen = _chosen(landmarks, drawn)
    np.testing.assert_array_equal(chosen.p_world, landmarks.p_world[drawn])
    for row, landmark in enumerate(drawn):
        theirs = landmarks.observed_keyframe[landmarks.observed_landmark == landmark]
        np.testing.assert_array_equal(
            np.sort(chosen.observed_keyframe[chosen.observed_landmark == row]), np.sort(theirs)
        )
