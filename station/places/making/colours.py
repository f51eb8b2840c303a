"""Numbers of places, by which points name their place and pages colour it: neighbours look different.

A number's remainder by HUES is a step on a wheel of colours, so that pages need no rule of their own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from station.model.place_map import Place, PlaceEdge

HUES = 12
MAX_NUMBERS = 255  # a byte, less the number that means no place
NEAREST = 4  # places nearby are seen side by side, also without an edge


def number_places(places: Sequence[Place], edges: Sequence[PlaceEdge], kept: Mapping[str, int]) -> dict[str, int]:
    """A number below MAX_NUMBERS for each place id; further places have none.

    Places in `kept` keep theirs, so that merging or hiding some changes no other's colour; those that are gone for now
    have theirs reserved, as a merge can be taken back.
    """
    numbers = {place.id: kept[place.id] for place in places if place.id in kept}
    taken = set(kept.values()) if len(kept.keys() | {p.id for p in places}) <= MAX_NUMBERS else set(numbers.values())
    beside = _neighbours(places, edges)
    uses = Counter(number % HUES for number in numbers.values())
    for place in places:
        if place.id in numbers:
            continue
        near = [numbers[other] % HUES for other in beside[place.id] if other in numbers]
        free = [n for n in range(MAX_NUMBERS) if n not in taken]
        if not free:
            break
        number = min(free, key=lambda n: (-_distance(n % HUES, near), uses[n % HUES], n))
        numbers[place.id] = number
        taken.add(number)
        uses[number % HUES] += 1
    return numbers


def _distance(hue: int, others: Sequence[int]) -> int:
    """Steps on the wheel to the nearest of the others."""
    return min((min((hue - other) % HUES, (other - hue) % HUES) for other in others), default=HUES)


def _neighbours(places: Sequence[Place], edges: Sequence[PlaceEdge]) -> dict[str, set[str]]:
    beside: dict[str, set[str]] = {place.id: set() for place in places}
    for edge in edges:
        if edge.a in beside and edge.b in beside:
            beside[edge.a].add(edge.b)
            beside[edge.b].add(edge.a)
    if len(places) > 1:
        centroids = np.array([place.centroid_map for place in places])
        for i, place in enumerate(places):
            order = np.argsort(((centroids - centroids[i]) ** 2).sum(axis=1), kind="stable")
            beside[place.id] |= {places[j].id for j in order[: NEAREST + 1] if j != i}
    return beside
