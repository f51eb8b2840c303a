"""Merging, hiding and showing places: pure, kept by the store, and never answered while hidden."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from shared.errors import DataError
from station.library.place_images import deviation_image
from station.maps.store import MapStore
from station.model.place_map import PlaceMap
from station.places.making.build import build_map, carry_names
from station.places.making.changes import with_place_hidden, with_places_merged, without_hidden
from station.places.making.config import PlacesMode
from station.places.making.place_images import images_of_place
from tests.support.places import estimator_of
from tests.support.synthetic_home import drive, furnished_room, navigate


@pytest.fixture(scope="module")
def place_map() -> PlaceMap:
    home = furnished_room(1)
    return build_map(navigate(home, drive(home, 1, frames=40, turns=1.0), seed=1))


def test_a_merged_place_holds_all_landmarks_and_the_first_name(place_map: PlaceMap) -> None:
    first, second, *others = place_map.places
    merged = with_places_merged(place_map, [first.id, second.id])
    place = merged.places[0]
    assert (place.id, place.name) == (first.id, first.name)
    both = set(first.landmark_index.tolist()) | set(second.landmark_index.tolist())
    assert set(place.landmark_index.tolist()) == both
    p = place_map.navigation.landmarks.p_world[place.landmark_index]
    np.testing.assert_allclose(place.centroid_map, p.mean(axis=0))
    assert place.radius >= min(first.radius, second.radius)
    assert set(place.keyframe_index.tolist()) >= set(first.keyframe_index.tolist())
    assert min(first.quality, second.quality) <= place.quality <= max(first.quality, second.quality)
    assert [p.id for p in merged.places[1:]] == [p.id for p in others]
    assert {end for edge in merged.edges for end in (edge.a, edge.b)} <= {p.id for p in merged.places}


@pytest.mark.parametrize("mode", ["default", "thesis"])
def test_the_representative_image_is_nearest_to_the_mean_image_that_is_shown(mode: PlacesMode) -> None:
    home = furnished_room(2)
    place_map = build_map(navigate(home, drive(home, 2, frames=40, turns=1.0), seed=2), mode=mode)
    assert len(place_map.places) > 2
    merged = with_places_merged(place_map, [place.id for place in place_map.places[:2]])
    for place in (*place_map.places, merged.places[0]):
        images = images_of_place(place_map, place)
        assert images.representative_keyframe == place.representative_keyframe >= 0
        white = cv2.imdecode(np.frombuffer(deviation_image(place_map, place), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert white is not None and white.shape == images.deviation.shape
        assert white.mean() == pytest.approx(np.minimum(2.55 * images.deviation, 255).mean(), abs=2)


def test_merging_is_the_same_in_any_grouping(place_map: PlaceMap) -> None:
    a, b, c = (place.id for place in place_map.places[:3])
    at_once = with_places_merged(place_map, [a, b, c])
    one_by_one = with_places_merged(with_places_merged(place_map, [a, b]), [a, c])
    assert at_once.edges == one_by_one.edges
    np.testing.assert_array_equal(at_once.places[0].landmark_index, one_by_one.places[0].landmark_index)


@pytest.mark.parametrize("ids", [["first"], ["first", "first"], ["first", "nowhere"]])
def test_a_merge_that_means_nothing_is_refused(place_map: PlaceMap, ids: list[str]) -> None:
    named = [place_map.places[0].id if word == "first" else word for word in ids]
    with pytest.raises(DataError, match="place"):
        with_places_merged(place_map, named)


def test_a_hidden_place_is_in_no_edge_and_comes_back_as_it_was(place_map: PlaceMap) -> None:
    gone = place_map.places[1]
    hidden = with_place_hidden(place_map, gone.id, True)
    assert gone.id not in {end for edge in hidden.edges for end in (edge.a, edge.b)}
    assert [p.id for p in without_hidden(hidden).places] == [p.id for p in place_map.places if p.id != gone.id]
    again = with_place_hidden(hidden, gone.id, False)
    assert again.edges == place_map.edges
    assert [(p.id, p.name, p.hidden) for p in again.places] == [(p.id, p.name, False) for p in place_map.places]


def test_the_store_keeps_what_is_hidden_and_merged(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(tmp_path)
    store.save(place_map)
    first, second, third = place_map.places[:3]
    store.edit(place_map.id, lambda m: with_place_hidden(m, third.id, True), "hidden")
    store.edit(place_map.id, lambda m: with_places_merged(m, [first.id, second.id]), "merged")
    again = MapStore(tmp_path).load(place_map.id)
    expected = with_places_merged(with_place_hidden(place_map, third.id, True), [first.id, second.id])
    assert [(p.id, p.name, p.hidden) for p in again.places] == [(p.id, p.name, p.hidden) for p in expected.places]
    assert again.edges == expected.edges
    np.testing.assert_array_equal(again.places[0].landmark_index, expected.places[0].landmark_index)


def test_a_place_stays_hidden_when_the_map_is_made_anew(place_map: PlaceMap) -> None:
    hidden = with_place_hidden(place_map, place_map.places[1].id, True)
    anew = carry_names(hidden, place_map)
    assert [p.hidden for p in anew.places] == [p.hidden for p in hidden.places]
    assert anew.edges == hidden.edges


def test_a_hidden_place_is_no_candidate_and_the_pose_is_kept(place_map: PlaceMap) -> None:
    estimator = estimator_of(place_map)
    before = estimator.place_probabilities()
    gone = place_map.places[0]
    estimator.regroup([without_hidden(with_place_hidden(place_map, gone.id, True))])
    answer = estimator.answer(1)
    assert gone.id not in {candidate.id for candidate in answer.alternatives}
    assert len(estimator.place_probabilities().place) == len(place_map.places) - 1
    assert estimator.place_probabilities().lost == pytest.approx(before.lost)
