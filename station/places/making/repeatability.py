"""How surely each place of a map would be found again: what it shares with the clusters of resampled landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.model.navigation import Landmarks
from station.model.place_map import PlaceMap
from station.places.making.clusters import NOISE, Clusters, Lengths, cluster_landmarks
from station.places.making.config import PlacesConfig, ThesisConfig
from station.places.making.gathering import gather

DRAWS = 10  # the mean of so many is still good to 0.1 only, of small places to less (docs/places.md)


def repeatability(place_map: PlaceMap, *, seed: int = 0) -> FloatArray:
    """(n,) 0..1 for each place: the share that it and its likest cluster have in common, of what either has.

    Landmarks are drawn with replacement, as another drive along the same path would find other ones of the same
    things, and grouped again with the map's own lengths. 1: always the same group; from 0.75 on a group may be called
    stable, below 0.6 it should not be trusted. Another path shows another side of things, which is not in it.
    Source: cluster-wise stability by bootstrap, Hennig, Computational Statistics & Data Analysis 52(1), 2007.
    """
    config, lengths = _made_with(place_map.config)
    navigation = place_map.navigation
    total = np.zeros(len(place_map.places))
    rng = np.random.default_rng(seed)
    for _ in range(DRAWS if place_map.places else 0):
        drawn = np.sort(rng.integers(0, len(navigation.landmarks), len(navigation.landmarks)))
        resampled = replace(navigation, landmarks=_chosen(navigation.landmarks, drawn))
        total += _largest_shares(place_map, cluster_landmarks(resampled, config, lengths=lengths), drawn)
    return total / DRAWS


def _largest_shares(place_map: PlaceMap, clusters: Clusters, drawn: IntArray) -> FloatArray:
    """(n,) Jaccard similarity of each place with its likest cluster, among the landmarks that were drawn."""
    unique, once = np.unique(drawn, return_index=True)
    label = np.full(len(place_map.navigation.landmarks), NOISE, dtype=np.int64)
    label[unique] = clusters.label[once]
    if place_map.grain == "rooms":
        label = _gathered(place_map, label)
    was_drawn = np.zeros(len(label), dtype=np.bool_)
    was_drawn[unique] = True
    size = np.bincount(label[label >= 0], minlength=clusters.count)
    shares = np.zeros(len(place_map.places))
    for k, place in enumerate(place_map.places):
        members = place.landmark_index[was_drawn[place.landmark_index]]
        common = np.bincount(label[members][label[members] >= 0], minlength=clusters.count)
        shares[k] = (common / np.maximum(len(members) + size - common, 1)).max(initial=0.0)
    return shares


def _gathered(place_map: PlaceMap, label: IntArray) -> IntArray:
    """Labels (M,) of clusters, those in one room gathered to as many as it has places in the map."""
    rooms = {} if place_map.plan is None else place_map.plan.room_of_place
    room_of_landmark = np.full(len(label), NOISE, dtype=np.int64)
    numbers = {room: n for n, room in enumerate(dict.fromkeys(rooms.get(place.id) for place in place_map.places))}
    for place in place_map.places:
        room_of_landmark[place.landmark_index] = numbers[rooms.get(place.id)]
    found = np.unique(label[label != NOISE])
    members = [np.flatnonzero(label == cluster) for cluster in found]
    centroid = np.array([place_map.navigation.landmarks.p_world[m].mean(axis=0) for m in members]).reshape(-1, 3)
    room = np.array([np.bincount(room_of_landmark[m] + 1, minlength=2)[1:].argmax() for m in members], dtype=np.int64)
    gathered = label.copy()
    for name, number in numbers.items():
        inside = np.flatnonzero(room == number)
        for group in gather(centroid[inside], sum(rooms.get(place.id) == name for place in place_map.places)):
            gathered[np.isin(label, found[inside[group]])] = found[inside[group[0]]]
    return gathered


def _chosen(landmarks: Landmarks, index: IntArray) -> Landmarks:
    """These landmarks (n,), as often as they are named, each with all its observations."""
    order = np.argsort(landmarks.observed_landmark, kind="stable")
    begin = np.searchsorted(landmarks.observed_landmark[order], np.arange(len(landmarks) + 1))
    count = begin[index + 1] - begin[index]
    first = np.cumsum(count) - count
    rows = order[np.arange(count.sum()) + np.repeat(begin[index] - first, count)]
    return Landmarks(
        p_world=landmarks.p_world[index],
        rgb=landmarks.rgb[index],
        cov_world=landmarks.cov_world[index],
        observed_landmark=np.repeat(np.arange(len(index)), count),
        observed_keyframe=landmarks.observed_keyframe[rows],
        observed_uv_px=landmarks.observed_uv_px[rows],
    )


def _made_with(said: Mapping[str, Any]) -> tuple[PlacesConfig, Lengths | None]:
    """What a map's places were made with, as its configuration says."""
    known = {field.name for field in fields(PlacesConfig)}
    given = {key: value for key, value in said.items() if key in known}
    config = PlacesConfig(**{**given, "thesis": ThesisConfig(**given.get("thesis", {}))})
    effective = said.get("effective", {})
    viewing, smoothing = effective.get("viewing_distance"), effective.get("smoothing")
    if not isinstance(viewing, float) or not isinstance(smoothing, float):
        return config, None
    return config, Lengths(viewing, smoothing / config.size_factor)
