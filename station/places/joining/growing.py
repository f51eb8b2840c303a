"""A map made anew keeps what an earlier one of the same first navigation had: places where some were added, or names.

Twice the landmarks make other hills, so that grouping all of them anew joins or cuts places that somebody named. Where
only navigations were added, the earlier places stay and grow by what was seen of them again; what is new elsewhere
becomes new places.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.geometry import IntArray
from station.model.place_map import PlaceMap
from station.places.joining.territory import Territory
from station.places.making.build import carry_names, describe_clusters, named_after
from station.places.making.changes import regrouped
from station.places.making.clusters import MIN_LANDMARKS, NOISE, Clusters
from station.places.making.config import PlacesConfig
from station.places.making.names import NAME_PREFIX

MIN_NEW = 0.5  # of a group's landmarks outside the earlier places: less is the blurred edge of one of them


def keep_places(earlier: PlaceMap, new: PlaceMap) -> PlaceMap:
    """`new` with the places of `earlier` where it holds the same navigations and further ones; else with their names.

    In the thesis mode names are all that is kept: its places are the clusters of the cloud and nothing else. Where
    places are to be gathered by rooms, `new` still has every cluster; what nobody named of an earlier such map is
    gathered anew.
    """
    kept = _kept(earlier, new)
    if earlier.grain == new.grain:
        return kept
    numbered = enumerate(kept.places, start=1)  # the numbers that places had are of others
    return replace(kept, places=tuple(p if p.named else replace(p, name=f"{NAME_PREFIX}{n}") for n, p in numbered))


def _kept(earlier: PlaceMap, new: PlaceMap) -> PlaceMap:
    if _begins_with(earlier, new) and (earlier.grain == "fine" or new.grain == "rooms"):
        if len(earlier.navigation.landmarks) < len(new.navigation.landmarks):
            return _grown(earlier, new)
        if earlier.grain == "rooms":
            return _gathered_again(earlier, new)
    return carry_names(earlier, new)


def _begins_with(earlier: PlaceMap, new: PlaceMap) -> bool:
    """Whether the landmarks of `earlier` are the first ones of `new`, which was grouped alike but for its grain."""
    first, p = earlier.navigation.landmarks.p_world, new.navigation.landmarks.p_world
    configs = [{k: v for k, v in m.config.items() if k not in ("effective", "places")} for m in (earlier, new)]
    return (
        bool(earlier.places)
        and configs[0] == configs[1]
        and new.config.get("mode") == "default"
        and np.array_equal(first, p[: len(first)], equal_nan=True)
    )


def _gathered_again(earlier: PlaceMap, new: PlaceMap) -> PlaceMap:
    """Of the same landmarks: the places that a person named or hid as they are, and the clusters of all others."""
    touched = tuple(place for place in earlier.places if place.named or place.hidden)
    kept = _grown(replace(earlier, places=touched), new) if touched else new
    names = {place.id: place.name for place in earlier.places}
    return replace(kept, places=tuple(replace(p, name=names.get(p.id, p.name)) for p in kept.places))


def _grown(earlier: PlaceMap, new: PlaceMap) -> PlaceMap:
    """The places of `earlier`, larger, and those of `new` that mostly lie outside of them."""
    navigation = new.navigation
    label = np.full(len(navigation.landmarks), NOISE, dtype=np.int64)
    for k, place in enumerate(earlier.places):
        label[place.landmark_index] = k
    quality = [place.quality for place in earlier.places]
    owner = _owners(earlier, new, label)
    for group in new.places:
        members = group.landmark_index
        outside = members[owner[members] == NOISE]
        if len(outside) >= max(MIN_LANDMARKS, MIN_NEW * len(members)):
            owner[outside] = len(quality)
            quality.append(group.quality)
    clusters = Clusters(label=owner, quality=np.array(quality), parameters={})
    places = describe_clusters(navigation, clusters, PlacesConfig())
    inherited = {
        j: earlier.places[k]
        for j, place in enumerate(places)
        for k in [int(owner[place.landmark_index[0]])]
        if k < len(earlier.places)
    }
    named = regrouped(replace(new, places=places), places)
    return named_after(earlier, named, inherited)


def _owners(earlier: PlaceMap, new: PlaceMap, label: IntArray) -> IntArray:
    """(M,) which earlier place each landmark of `new` belongs to, or NOISE: as before, or where it was grouped now and
    lies in its territory."""
    first = len(earlier.navigation.landmarks)
    owner = label.copy()
    grouped = np.concatenate([np.zeros(0, dtype=np.int64), *(place.landmark_index for place in new.places)])
    added = grouped[grouped >= first]
    owner[added] = Territory(earlier).place_of(new.navigation.landmarks.p_world[added])
    return owner
