"""Locations of a second navigation ↔ places of the map (thesis 4.4, steps 4-7; fig. 5.5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray, IntArray, transform
from station.model.navigation import Navigation
from station.model.place_map import Place, PlaceMap
from station.places.joining.align import align_navigation
from station.places.joining.match_result import MatchResult, PlaceMatch
from station.places.joining.territory import Territory
from station.places.making.build import describe_clusters
from station.places.making.clusters import MIN_LANDMARKS, NOISE, Clusters, Lengths, cluster_landmarks
from station.places.making.config import PlacesConfig
from station.places.making.scale import half_extent
from station.places.registration.result import Registration

MAX_DISTANCE_SHARE = 0.8  # of the place's half extent: a farther centroid is another place, or a part of this one
MIN_SUPPORT = 0.5  # share of a location's landmarks that lie in the place
MIN_PART = 0.2  # of a location's landmarks in one place: less is its blurred edge,
MIN_SEEN = 0.5  # unless they are so many as the place has: a small place beside a large one, seen as a whole


def match_navigation(
    place_map: PlaceMap, navigation: Navigation, config: PlacesConfig | None = None, *, seed: int = 0
) -> MatchResult:
    """Register, carry the robot and the locations over, and give each place its closest location.

    Without an accepted registration there are no matches. A map or a navigation without places: no matches either.
    """
    config = config or PlacesConfig()
    registration = align_navigation(place_map, navigation, config, seed=seed)
    T_map_nav = registration.T_target_source if registration.accepted else None
    clusters = own = cluster_landmarks(navigation, config, lengths=_lengths_of(place_map, registration))
    if T_map_nav is not None and config.mode == "default":
        clusters = _regroup(place_map, navigation, clusters, T_map_nav)
    locations = describe_clusters(navigation, clusters, config, prefix="Location ")
    if T_map_nav is None:
        return MatchResult(registration, own, locations, (), (), np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
    pairs = _one_to_one(place_map, navigation, locations, T_map_nav)
    judged = [(pair, "" if config.mode == "thesis" else _objection(place_map, pair)) for pair in pairs]
    position_map = transform(T_map_nav, navigation.keyframes.T_world_cam[:, :3, 3])
    return MatchResult(
        registration=registration,
        clusters=own,
        locations=locations,
        matches=tuple(pair for pair, reason in judged if not reason),
        refused=tuple((pair, reason) for pair, reason in judged if reason),
        position_map=position_map,
        nearest_place=_nearest_place(place_map, position_map),
    )


def _lengths_of(place_map: PlaceMap, registration: Registration) -> Lengths | None:
    """The map's cluster lengths in the navigation's units."""
    effective = place_map.config.get("effective")
    if not isinstance(effective, dict) or not registration.accepted:
        return None
    viewing, smoothing = effective.get("viewing_distance"), effective.get("smoothing")
    if not isinstance(viewing, float) or not isinstance(smoothing, float):
        return None
    return Lengths(viewing, smoothing).scaled(1.0 / registration.scale)


def _one_to_one(
    place_map: PlaceMap, navigation: Navigation, locations: tuple[Place, ...], T_map_nav: FloatArray
) -> list[PlaceMatch]:
    """Each location's nearest place; of several locations at one place the closest stays (fig. 5.5)."""
    if not place_map.places or not locations:
        return []
    places = np.array([place.centroid_map for place in place_map.places])
    carried = transform(T_map_nav, np.array([location.centroid_map for location in locations]))
    distance = np.linalg.norm(places[:, None] - carried[None], axis=2)
    territory = Territory(place_map)
    best: dict[int, PlaceMatch] = {}
    for j, location in enumerate(locations):
        i = int(distance[:, j].argmin())
        if i in best and best[i].distance <= distance[i, j]:
            continue
        p_map = transform(T_map_nav, navigation.landmarks.p_world[location.landmark_index])
        support = float((territory.place_of(p_map) == i).mean())
        best[i] = PlaceMatch(place_map.places[i].id, location.id, float(distance[i, j]), support)
    return sorted(best.values(), key=lambda match: match.distance)


def _objection(place_map: PlaceMap, match: PlaceMatch) -> str:
    """Why the default mode does not believe a match; empty when it does."""
    place = next(place for place in place_map.places if place.id == match.place_id)
    limit = MAX_DISTANCE_SHARE * half_extent(place_map.navigation.landmarks.p_world[place.landmark_index])
    if match.distance > limit:
        return f"its centroid is {match.distance:.3g} away, more than {limit:.3g} for a place of this size"
    if match.support < MIN_SUPPORT:
        return f"only {match.support:.0%} of its landmarks lie in the place"
    return ""


def _regroup(place_map: PlaceMap, navigation: Navigation, clusters: Clusters, T_map_nav: FloatArray) -> Clusters:
    """Locations cut where the map's places meet, and joined where they are parts of one place.

    Two navigations rarely cut one wall at the same spot. Where the clouds lie on each other, the map already says where
    its places end; a location takes part with the landmarks that it saw itself, or keeps its own shape where the map
    has nothing.
    """
    if not place_map.places or not clusters.count:
        return clusters
    territory = Territory(place_map)
    sizes = np.array([len(place.landmark_index) for place in place_map.places])
    p_map = transform(T_map_nav, navigation.landmarks.p_world)
    label = np.full(len(clusters.label), NOISE, dtype=np.int64)
    quality: list[float] = []
    group_of_place: dict[int, int] = {}
    for k in range(clusters.count):
        members = clusters.members(k)
        place = territory.place_of(p_map[members])
        counts = np.bincount(place[place >= 0], minlength=len(place_map.places))
        enough = (counts >= MIN_PART * len(members)) | (counts >= MIN_SEEN * sizes)
        parts = np.flatnonzero((counts >= MIN_LANDMARKS) & enough)
        if not len(parts) or counts[parts].sum() < MIN_SUPPORT * len(members):
            label[members] = len(quality)
            quality.append(float(clusters.quality[k]))
            continue
        for i in parts.tolist():
            if i not in group_of_place:
                group_of_place[i] = len(quality)
                quality.append(float(clusters.quality[k]))
            label[members[place == i]] = group_of_place[i]
    return replace(clusters, label=label, quality=np.array(quality))


def _nearest_place(place_map: PlaceMap, position_map: FloatArray) -> IntArray:
    if not place_map.places:
        return np.zeros(0, dtype=np.int64)
    places = np.array([place.centroid_map for place in place_map.places])
    return np.linalg.norm(position_map[:, None] - places[None], axis=2).argmin(axis=1).astype(np.int64)
