"""A navigation → a map of named places."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray, scale_of, transform
from station.model.navigation import Navigation
from station.model.place_map import Place, PlaceMap
from station.places.making.changes import regrouped
from station.places.making.clusters import Clusters, cluster_landmarks
from station.places.making.config import PlacesConfig, PlacesMode
from station.places.making.graph import place_edges
from station.places.making.names import NAME_PREFIX
from station.places.making.place_images import keyframes_of_place, make_place_images, observing_keyframes


def build_map(
    navigation: Navigation,
    mode: PlacesMode | None = None,
    config: PlacesConfig | None = None,
    *,
    name: str = "",
) -> PlaceMap:
    """Places, their graph and their names (thesis 4.4, steps 2-3). A cloud without clusters gives a map without places.

    Ids are made from the navigation and the configuration: the same navigation gives the same map, bit for bit.
    """
    config = config or PlacesConfig()
    if mode is not None:
        config = replace(config, mode=mode)
    clusters = cluster_landmarks(navigation, config)
    places = describe_clusters(navigation, clusters, config)
    effective = {**config.as_dict(), "effective": clusters.parameters}
    digest = hashlib.sha256(json.dumps([navigation.id, effective], sort_keys=True, default=str).encode()).hexdigest()
    return PlaceMap(
        id=f"map-{digest[:12]}",
        name=name or f"Map of {navigation.id}",
        navigation=navigation,
        places=places,
        edges=place_edges(navigation, places),
        config=effective,
    )


def describe_clusters(
    navigation: Navigation, clusters: Clusters, config: PlacesConfig, *, prefix: str = NAME_PREFIX
) -> tuple[Place, ...]:
    """Every cluster as a place, named in the order the camera first saw them."""
    landmarks = navigation.landmarks
    members = [clusters.members(k) for k in range(clusters.count)]
    first_seen = landmarks.first_keyframe()
    order = sorted(range(clusters.count), key=lambda k: (float(np.median(first_seen[members[k]])), k))
    ids = {k: f"{_word(prefix)}-{_digest(navigation.id, members[k].tolist())}" for k in order}
    thesis = config.mode == "thesis"
    chosen = {ids[k]: keyframes_of_place(landmarks, members[k], thesis=thesis) for k in order}
    images = make_place_images(navigation.keyframes, chosen)
    places = []
    for number, k in enumerate(order, start=1):
        p = landmarks.p_world[members[k]]
        centroid = p.mean(axis=0)
        keyframe_index, _ = observing_keyframes(landmarks, members[k])
        places.append(
            Place(
                id=ids[k],
                name=f"{prefix}{number}",
                centroid_map=centroid,
                radius=float(np.sqrt(((p - centroid) ** 2).sum(axis=1).mean())),
                landmark_index=members[k],
                keyframe_index=keyframe_index,
                representative_keyframe=images[ids[k]].representative_keyframe,
                quality=float(clusters.quality[k]),
            )
        )
    return tuple(places)


def carry_names(old: PlaceMap, new: PlaceMap, T_new_old: FloatArray | None = None) -> PlaceMap:
    """`new` with the ids and names of the places of `old` that it holds again.

    A place is held again by the nearest new place whose centroid lies within the larger radius; one-to-one, closest
    first. Places of `old` that are not found leave their names unused; new places get numbers that were never used.
    `T_new_old` (4, 4) maps the old map's frame to the new one's; None: same frame, as after clustering again.
    """
    T = np.eye(4) if T_new_old is None else T_new_old
    scale = scale_of(T)
    pairs = sorted(
        (float(np.linalg.norm(after - before.centroid_map)), i, j)
        for i, source in enumerate(old.places)
        for after in [transform(T, source.centroid_map[None])[0]]
        for j, before in enumerate(new.places)
        if np.linalg.norm(after - before.centroid_map) <= max(scale * source.radius, before.radius)
    )
    inherited: dict[int, Place] = {}
    taken: set[int] = set()
    for _, i, j in pairs:
        if i not in taken and j not in inherited:
            taken.add(i)
            inherited[j] = old.places[i]
    return named_after(old, new, inherited)


def named_after(old: PlaceMap, new: PlaceMap, inherited: Mapping[int, Place]) -> PlaceMap:
    """`new` with the ids and names of the places of `old` that its places (by number) inherit; one-to-one."""
    numbers = iter(range(_last_number(old.places) + 1, _last_number(old.places) + len(new.places) + 1))
    renamed: dict[str, str] = {}
    # A place whose id another one inherits, as from places that a person made one, gets the id which that one leaves.
    left = {source.id: new.places[j].id for j, source in inherited.items()}
    places = []
    for j, place in enumerate(new.places):
        source = inherited.get(j)
        new_id = source.id if source else _follow(left, place.id)
        renamed[place.id] = new_id
        if source is None:
            places.append(replace(place, id=new_id, name=f"{NAME_PREFIX}{next(numbers)}"))
        else:
            places.append(replace(place, id=source.id, name=source.name, named=source.named, hidden=source.hidden))
    edges = tuple(replace(edge, a=renamed[edge.a], b=renamed[edge.b]) for edge in new.edges)
    named = replace(new, places=tuple(places), edges=edges)
    return regrouped(named, named.places) if any(place.hidden for place in places) else named


def _follow(left: Mapping[str, str], place_id: str) -> str:
    while place_id in left:
        place_id = left[place_id]
    return place_id


def _last_number(places: Sequence[Place]) -> int:
    numbers = [place.name.removeprefix(NAME_PREFIX) for place in places if place.name.startswith(NAME_PREFIX)]
    return max([int(number) for number in numbers if number.isdecimal()], default=0)


def _word(prefix: str) -> str:
    return prefix.strip().lower() or "place"


def _digest(navigation_id: str, members: list[int]) -> str:
    return hashlib.sha256(json.dumps([navigation_id, members]).encode()).hexdigest()[:12]
