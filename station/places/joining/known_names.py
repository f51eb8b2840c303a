"""What rooms of a map were called in another map of the same home, made from another drive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from shared.geometry import inverse_sim3
from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.place_map import PlaceMap
from station.places.joining.align import align_navigation
from station.places.making.config import PlacesConfig
from station.places.rooms.identity import inherited, shared_cells


def names_in(other: PlaceMap, place_map: PlaceMap, config: PlacesConfig) -> tuple[NameSuggestion, ...]:
    """Names that people gave rooms of `other` for the rooms of a map that lie there: none where it is not registered.

    A name is as probable as the part of the room that was called so, and no surer than either plan is of its room.
    """
    plan, known = place_map.plan, other.plan
    if plan is None or known is None or not plan.rooms or not known.rooms:
        return ()
    registration = align_navigation(other, place_map.navigation, config)
    if not registration.accepted or registration.T_target_source is None:
        return ()
    T_map_other = inverse_sim3(registration.T_target_source)
    labels = plan.room.astype(np.int32) + 1
    cells = labels, len(plan.rooms), plan.low, plan.cell, plan.R_ground_map, known, T_map_other
    shared = shared_cells(*cells)
    found = []
    for label, old in sorted(inherited(*cells).items()):
        room, then = plan.rooms[label - 1], known.rooms[old]
        if then.id not in other.plan_edits.names or room.id in place_map.plan_edits.names:
            continue  # a person did not name it there, or named it here
        share = float(shared[label, old] / np.count_nonzero(labels == label))
        found.append(
            NameSuggestion(
                room=room.id,
                name=then.name,
                source="other map",
                confidence=share * min(room.certainty, then.certainty),
                reason=f'{share:.0%} of this room is {then.name} in the map "{other.name}", which is of the same home.',
                keyframe_index=_inside(place_map, plan, label - 1),
            )
        )
    return tuple(found)


def surest_of_each(found: Iterable[NameSuggestion]) -> tuple[NameSuggestion, ...]:
    """Of equal names for one room the surest; several names share their confidence."""
    kept = {(s.room, s.name): s for s in sorted(found, key=lambda s: s.confidence)}
    names = Counter(room for room, _ in kept)
    return tuple(
        replace(s, confidence=s.confidence / names[s.room]) for _, s in sorted(kept.items(), key=lambda i: i[0])
    )


def _inside(place_map: PlaceMap, plan: FloorPlan, number: int) -> int | None:
    """The picture that was taken in a room, nearest to its middle; None: none was."""
    p = place_map.navigation.keyframes.T_world_cam[:, :3, 3]
    inside = np.flatnonzero(plan.rooms_at(p) == number)
    if not len(inside):
        return None
    away = np.linalg.norm((p[inside] @ plan.R_ground_map.T)[:, :2] - plan.rooms[number].middle, axis=1)
    return int(inside[away.argmin()])
