"""Numbers of places: unique, stable under merging, and far apart on the colour wheel where places are neighbours."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.model.place_map import Place, PlaceEdge
from station.places.making.colours import HUES, MAX_NUMBERS, number_places

NOTHING = np.zeros(0, dtype=np.int64)


def places_in_a_row(count: int) -> list[Place]:
    return [
        Place(f"p{i}", f"Place {i + 1}", np.array([float(i), 0.0, 0.0]), 0.3, NOTHING, NOTHING, -1, 0.5)
        for i in range(count)
    ]


def steps(a: int, b: int) -> int:
    return min((a - b) % HUES, (b - a) % HUES)


def test_neighbours_are_far_apart_on_the_wheel() -> None:
    places = places_in_a_row(12)
    edges = [PlaceEdge(a.id, b.id, 0.0, 1.0, "nearest") for a, b in itertools.pairwise(places)]
    numbers = number_places(places, edges, {})
    assert all(steps(numbers[edge.a], numbers[edge.b]) >= 2 for edge in edges)


@given(count=st.integers(0, 300), gone=st.integers(0, 299))
def test_numbers_are_unique_bytes_and_stay_when_a_place_goes_and_comes_back(count: int, gone: int) -> None:
    places = places_in_a_row(count)
    numbers = number_places(places, [], {})
    assert len(set(numbers.values())) == len(numbers) == min(count, MAX_NUMBERS)
    assert all(0 <= number < MAX_NUMBERS for number in numbers.values())
    fewer = [place for place in places if place.id != f"p{gone}"]
    after = number_places(fewer, [], numbers)
    assert all(after[place.id] == numbers[place.id] for place in fewer if place.id in numbers)
    again = number_places(places, [], {**numbers, **after})
    assert all(again[name] == number for name, number in numbers.items())


def test_a_new_place_does_not_take_the_number_of_one_that_may_come_back() -> None:
    places = places_in_a_row(3)
    numbers = number_places(places, [], {})
    newcomer = replace(places[0], id="new")
    assert number_places([newcomer, *places[1:]], [], numbers)["new"] not in numbers.values()
