"""Places by room: at most six in each, of neighbours, with nothing lost and nothing taken from a person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.model.place_map import PlaceMap
from station.places.joining.growing import keep_places
from station.places.joining.merge import append_navigation
from station.places.making.build import build_map
from station.places.making.gathering import gather
from station.places.making.repeatability import repeatability
from station.places.rooms.gathering import AT_MOST, gathered
from tests.support.synthetic_home import drive, furnished_room, navigate

WALL_X = 0.0


def test_what_is_gathered_are_the_heaps_that_lie_apart() -> None:
    rng = np.random.default_rng(3)
    heap = np.repeat(np.arange(6), [1, 2, 3, 4, 5, 12])
    p = np.column_stack([3.0 * heap, 2.0 * (heap % 2), 0.0 * heap]) + rng.uniform(-0.5, 0.5, (len(heap), 3))
    shuffled = rng.permutation(len(heap))
    groups = gather(p[shuffled], 6)
    assert sorted(sorted({int(h) for h in heap[shuffled][group]}) for group in groups) == [[k] for k in range(6)]
    assert [int(group[0]) for group in groups] == sorted(int(group[0]) for group in groups)


@pytest.mark.parametrize("count", [0, 1, 6])
def test_few_points_stay_by_themselves(count: int) -> None:
    assert [group.tolist() for group in gather(np.eye(6, 3)[:count], 6)] == [[i] for i in range(count)]


@pytest.fixture(scope="module")
def fine() -> PlaceMap:
    home = furnished_room(3, density=300)
    return build_map(navigate(home, drive(home, 31, frames=40, turns=1.0), seed=31, name="day")).with_grain("rooms")


def sides(place_map: PlaceMap) -> dict[str, str]:
    """As if a wall stood along x = WALL_X."""
    return {place.id: "left" if place.centroid_map[0] < WALL_X else "right" for place in place_map.places}


def landmarks(place_map: PlaceMap) -> list[int]:
    return sorted(int(i) for place in place_map.places for i in place.landmark_index)


def test_each_room_gets_at_most_six_places_of_its_own_landmarks(fine: PlaceMap) -> None:
    rooms = sides(fine)
    made = gathered(fine, rooms)
    assert max(list(rooms.values()).count(side) for side in ("left", "right")) > AT_MOST
    for side in ("left", "right"):
        before = [place for place in fine.places if rooms[place.id] == side]
        now = [place for place in made.places if rooms[place.id] == side]
        assert len(now) == min(AT_MOST, len(before))
        assert sorted(int(i) for p in now for i in p.landmark_index) == sorted(
            int(i) for p in before for i in p.landmark_index
        )
    assert landmarks(made) == landmarks(fine)
    assert {end for edge in made.edges for end in (edge.a, edge.b)} <= {place.id for place in made.places}
    assert gathered(made, rooms) is made


def test_outside_of_all_rooms_places_are_gathered_as_in_one(fine: PlaceMap) -> None:
    assert len(gathered(fine, {}).places) == AT_MOST


def touched(place_map: PlaceMap) -> PlaceMap:
    """The first place named, the second one hidden."""
    first, second, *others = place_map.places
    return replace(place_map, places=(replace(first, name="Sofa", named=True), replace(second, hidden=True), *others))


def test_what_a_person_named_or_hid_stays_as_it_is(fine: PlaceMap) -> None:
    made = gathered(touched(fine), {})
    kept = {place.id: place for place in made.places}
    for before in touched(fine).places[:2]:
        now = kept[before.id]
        assert (now.name, now.named, now.hidden) == (before.name, before.named, before.hidden)
        assert now.landmark_index.tolist() == before.landmark_index.tolist()
    assert len([place for place in made.places if not place.hidden]) == AT_MOST


def test_where_all_places_are_named_what_is_new_is_one_more(fine: PlaceMap) -> None:
    made = gathered(fine, {})
    names = [replace(place, name=f"Corner {n}", named=True) for n, place in enumerate(made.places)]
    ids = {i for place in names[1:] for i in place.landmark_index.tolist()}
    new = [place for place in fine.places if not ids & set(place.landmark_index.tolist())]
    again = gathered(replace(fine, places=(*names[1:], replace(names[0], id="corner-0"), *new[:3])), {})
    assert len(again.places) == AT_MOST + 1


def test_the_same_drive_again_keeps_named_places_whole_and_gathers_the_others_as_before(fine: PlaceMap) -> None:
    before = touched(gathered(fine, {}))
    again = gathered(keep_places(before, fine), {})
    assert [(p.id, p.name, p.named, p.hidden) for p in again.places if p.named or p.hidden] == [
        (p.id, p.name, p.named, p.hidden) for p in before.places[:2]
    ]
    assert sorted((p.id, p.name, len(p.landmark_index)) for p in again.places) == sorted(
        (p.id, p.name, len(p.landmark_index)) for p in before.places
    )


def test_a_drive_added_leaves_the_places_and_at_most_six(fine: PlaceMap) -> None:
    before = touched(gathered(fine, {}))
    home = furnished_room(3, density=300)
    second = navigate(home, drive(home, 32, frames=40), seed=32, name="next day")
    both = build_map(append_navigation(fine.navigation, second, np.eye(4))).with_grain("rooms")
    grown = gathered(keep_places(before, both), {})
    assert len([place for place in grown.places if not place.hidden]) <= AT_MOST
    assert {place.id for place in before.places} == {place.id for place in grown.places}
    assert sum(len(p.landmark_index) for p in grown.places) > sum(len(p.landmark_index) for p in before.places)
    assert [place.name for place in grown.places if place.named] == ["Sofa"]


def test_a_map_of_all_clusters_can_be_made_of_one_by_rooms_and_the_other_way(fine: PlaceMap) -> None:
    all_clusters = fine.with_grain("fine")
    assert "places" not in all_clusters.config
    by_rooms = touched(gathered(fine, {}))
    back = keep_places(by_rooms, all_clusters)
    assert len(back.places) == len(fine.places) and "Sofa" in {place.name for place in back.places if place.named}
    assert len({place.id for place in back.places}) == len(back.places)
    forward = keep_places(touched(all_clusters), fine)
    assert [place.name for place in gathered(forward, {}).places if place.named] == ["Sofa"]


def test_clusters_of_the_thesis_mode_are_never_gathered(fine: PlaceMap) -> None:
    assert build_map(fine.navigation, "thesis").with_grain("rooms").grain == "fine"


def test_places_by_room_are_found_again_as_surely_as_their_clusters(fine: PlaceMap) -> None:
    made = gathered(fine, {})
    assert repeatability(made).mean() > repeatability(replace(made, config=fine.with_grain("fine").config)).mean()
