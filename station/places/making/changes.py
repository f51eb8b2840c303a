"""What a person makes of the places of a map: two that are one, one that is none. Pure: a map in, another one out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shared.errors import DataError
from station.model.place_map import Place, PlaceMap
from station.places.making.graph import place_edges
from station.places.making.place_images import keyframes_shown, make_place_images, observing_keyframes


def without_hidden(place_map: PlaceMap) -> PlaceMap:
    """The map without its hidden places: what localisation answers from. Edges never lead to hidden places."""
    return replace(place_map, places=tuple(place for place in place_map.places if not place.hidden))


def with_place_hidden(place_map: PlaceMap, place_id: str, hidden: bool) -> PlaceMap:
    """The map with one place hidden, or shown again. It keeps its name; the graph is made without it.

    Raises:
        DataError: the map has no such place.
    """
    _find(place_map, [place_id])
    places = tuple(replace(place, hidden=hidden) if place.id == place_id else place for place in place_map.places)
    return regrouped(place_map, places)


def with_places_merged(place_map: PlaceMap, place_ids: Sequence[str]) -> PlaceMap:
    """The map with several places as one, which keeps id and name of the first; shown if any of them is.

    Raises:
        DataError: the map lacks one of the places, or fewer than two different ones are named.
    """
    found = _find(place_map, place_ids)
    if len({place.id for place in found}) < 2:
        raise DataError("two different places are needed to merge them; GET /places lists them")
    return joined(place_map, [found])


def joined(place_map: PlaceMap, groups: Sequence[Sequence[Place]]) -> PlaceMap:
    """The map with each group of its places as one, which keeps id and name of the first; shown if any of them is."""
    merged = {group[0].id: _one_of(place_map, group) for group in groups if len(group) > 1}
    if not merged:
        return place_map
    gone = {place.id for group in groups for place in group[1:]}
    chosen = {place.id: keyframes_shown(place_map, place) for place in merged.values()}
    images = make_place_images(place_map.navigation.keyframes, chosen)
    places = tuple(
        replace(merged[place.id], representative_keyframe=images[place.id].representative_keyframe)
        if place.id in merged
        else place
        for place in place_map.places
        if place.id not in gone
    )
    return regrouped(place_map, places)


def _one_of(place_map: PlaceMap, parts: Sequence[Place]) -> Place:
    """One place that holds the landmarks of all, but for its representative image."""
    landmarks = place_map.navigation.landmarks
    members = np.unique(np.concatenate([place.landmark_index for place in parts]))
    p = landmarks.p_world[members]
    centroid = p.mean(axis=0)
    keyframe_index, _ = observing_keyframes(landmarks, members)
    weights = [max(len(place.landmark_index), 1) for place in parts]
    return replace(
        parts[0],
        centroid_map=centroid,
        radius=float(np.sqrt(((p - centroid) ** 2).sum(axis=1).mean())),
        landmark_index=members,
        keyframe_index=keyframe_index,
        quality=float(np.average([place.quality for place in parts], weights=weights)),
        hidden=all(place.hidden for place in parts),
    )


def regrouped(place_map: PlaceMap, places: tuple[Place, ...]) -> PlaceMap:
    """The map with these places, and the graph between those that are shown."""
    visible = [place for place in places if not place.hidden]
    return replace(place_map, places=places, edges=place_edges(place_map.navigation, visible))


def _find(place_map: PlaceMap, place_ids: Sequence[str]) -> list[Place]:
    by_id = {place.id: place for place in place_map.places}
    for place_id in place_ids:
        if place_id not in by_id:
            raise DataError(f'map "{place_map.name}" has no place with id "{place_id}"; GET /places lists them')
    return [by_id[place_id] for place_id in place_ids]
