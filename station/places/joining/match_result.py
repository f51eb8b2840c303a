"""What came of looking for the places of a map in a navigation."""

from __future__ import annotations

from dataclasses import dataclass

from shared.geometry import FloatArray, IntArray
from station.model.place_map import Place
from station.places.making.clusters import Clusters
from station.places.registration.result import Registration


@dataclass(frozen=True, slots=True)
class PlaceMatch:
    """One location and the place it is held to be."""

    place_id: str
    location_id: str
    distance: float  # between the centroids, map units
    support: float  # share of the location's landmarks nearest to this place's


@dataclass(frozen=True, slots=True, eq=False)
class MatchResult:
    """What a second navigation has in common with the map."""

    registration: Registration
    clusters: Clusters  # of the navigation alone, before the map had a say
    locations: tuple[Place, ...]  # in the navigation's own frame; in the default mode cut and joined like the places
    matches: tuple[PlaceMatch, ...]  # one-to-one, closest first
    refused: tuple[tuple[PlaceMatch, str], ...]  # pairs that a stricter look turned down, with the reason
    position_map: FloatArray  # (F, 3) the robot's camera at every keyframe; (0, 3) without a registration
    nearest_place: IntArray  # (F,) index into map.places; empty likewise, or where the map has no place
