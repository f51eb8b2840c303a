"""A map that a drive was added to keeps its places and gains new ones."""

from dataclasses import replace

import numpy as np
import pytest

from shared.geometry import FloatArray, se3
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.joining.growing import keep_places
from station.places.joining.merge import append_navigation
from station.places.making.build import build_map, carry_names
from station.places.making.changes import with_place_hidden, with_places_merged
from tests.support.synthetic_home import drive, furnished_room, navigate


def day(room: int, seed: int, T_nav_world: FloatArray | None = None) -> Navigation:
    home = furnished_room(room, density=200)
    poses = drive(home, seed, frames=40)
    return navigate(home, poses, seed=seed, T_nav_world=T_nav_world, name=f"day-{seed}", noise_m=0.02)


FIRST, SECOND = day(3, 31), day(3, 32)


@pytest.fixture(scope="module")
def earlier() -> PlaceMap:
    """What a person made of the first day: names, two places that are one, one that is none."""
    place_map = build_map(FIRST)
    named = tuple(replace(place, name=f"Corner {k}") for k, place in enumerate(place_map.places))
    place_map = replace(place_map, places=named)
    near = min(place_map.edges, key=lambda edge: edge.distance)
    place_map = with_places_merged(place_map, [near.a, near.b])
    return with_place_hidden(place_map, place_map.places[-1].id, True)


def test_places_stay_and_grow_when_a_drive_is_added(earlier: PlaceMap) -> None:
    both = append_navigation(FIRST, SECOND, np.eye(4))
    grown = keep_places(earlier, build_map(both))
    kept = {place.id: place for place in grown.places}
    count = len(FIRST.landmarks)
    for place in earlier.places:
        now = kept[place.id]
        assert (now.name, now.hidden) == (place.name, place.hidden)
        assert now.landmark_index[now.landmark_index < count].tolist() == place.landmark_index.tolist()
        assert np.linalg.norm(now.centroid_map - place.centroid_map) < 0.5 * place.radius
    # Most of what the second drive saw of them belongs to them, nothing to two of them.
    members = np.concatenate([place.landmark_index for place in grown.places])
    assert len(np.unique(members)) == len(members)
    of_second = np.concatenate([kept[place.id].landmark_index for place in earlier.places])
    assert (of_second >= count).sum() > 0.8 * len(SECOND.landmarks)
    assert {end for edge in grown.edges for end in (edge.a, edge.b)} <= {p.id for p in grown.places if not p.hidden}


def test_what_a_drive_saw_elsewhere_becomes_new_places(earlier: PlaceMap) -> None:
    next_door = day(4, 33, se3(np.eye(3), np.array([7.0, 0.0, 0.0])))
    grown = keep_places(earlier, build_map(append_navigation(FIRST, next_door, np.eye(4))))
    names = [place.name for place in grown.places]
    assert len(set(names)) == len(names) and {place.name for place in earlier.places} <= set(names)
    new = [place for place in grown.places if place.name not in {old.name for old in earlier.places}]
    assert abs(len(new) - len(build_map(next_door).places)) <= 2
    assert all(place.centroid_map[0] > 6.5 for place in new)


@pytest.mark.parametrize("what", ["the same drive again", "SLAM run again", "thesis"])
def test_elsewhere_only_the_names_are_carried(earlier: PlaceMap, what: str) -> None:
    both = append_navigation(FIRST, SECOND, np.eye(4))
    navigation = {"the same drive again": FIRST, "SLAM run again": SECOND, "thesis": both}[what]
    new = build_map(navigation, "thesis" if what == "thesis" else "default")
    kept, carried = keep_places(earlier, new), carry_names(earlier, new)
    assert [(place.id, place.name) for place in kept.places] == [(place.id, place.name) for place in carried.places]
    assert [len(place.landmark_index) for place in kept.places] == [len(place.landmark_index) for place in new.places]
