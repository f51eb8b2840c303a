"""What rooms of a map were called in another map of the same home, made from another drive."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray, inverse_sim3, transform
from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.place_map import PlaceMap
from station.places.joining.align import align_navigation
from station.places.making.config import PlacesConfig
from station.places.rooms.identity import one_to_one, shared_cells


def names_in(other: PlaceMap, place_map: PlaceMap, config: PlacesConfig) -> tuple[NameSuggestion, ...]:
    """Names that people gave rooms of `other` for the rooms of a map that lie there: none where it is not registered.

    A name is as probable as the part of the room that was called so, of what rooms of both maps cover, and no surer
    than the registration and either plan of its room. Where the middle of neither room lies in the other they only
    touch, as two sides of one wall do: that says nothing.
    """
    plan, known = place_map.plan, other.plan
    if plan is None or known is None or not plan.rooms or not known.rooms:
        return ()
    registration = align_navigation(other, place_map.navigation, config)
    T_other_map = registration.T_target_source
    if not registration.accepted or T_other_map is None:
        return ()
    T_map_other = inverse_sim3(T_other_map)
    labels = plan.room.astype(np.int32) + 1
    shared = shared_cells(labels, len(plan.rooms), plan.low, plan.cell, plan.R_ground_map, known, T_map_other)
    room_there = known.rooms_at(transform(T_other_map, _middles(plan)))
    room_here = plan.rooms_at(transform(T_map_other, _middles(known)))
    found = []
    for label, old in sorted(one_to_one(shared).items()):
        room, then = plan.rooms[label - 1], known.rooms[old]
        if then.id not in other.plan_edits.names or room.id in place_map.plan_edits.names:
            continue  # a person did not name it there, or named it here
        if room_there[label - 1] != old and room_here[old] != label - 1:
            continue
        seen = int(shared[label].sum())
        share, coverage = float(shared[label, old] / seen), float(seen / np.count_nonzero(labels == label))
        found.append(
            NameSuggestion(
                room=room.id,
                name=then.name,
                source="other map",
                confidence=share * registration.confidence * min(room.certainty, then.certainty),
                reason=f'Of this room {coverage:.0%} is in the map "{other.name}", and {share:.0%} of that is '
                f"{then.name} there.",
                keyframe_index=_inside(place_map, plan, label - 1),
            )
        )
    return tuple(found)


def _middles(plan: FloorPlan) -> FloatArray:
    """(R, 3) of its rooms, in the map, at the height of its origin."""
    ground = np.array([[*room.middle, 0.0] for room in plan.rooms])
    return np.asarray(ground @ plan.R_ground_map)


def _inside(place_map: PlaceMap, plan: FloorPlan, number: int) -> int | None:
    """The picture that was taken in a room, nearest to its middle; None: none was."""
    p = place_map.navigation.keyframes.T_world_cam[:, :3, 3]
    inside = np.flatnonzero(plan.rooms_at(p) == number)
    if not len(inside):
        return None
    away = np.linalg.norm((p[inside] @ plan.R_ground_map.T)[:, :2] - plan.rooms[number].middle, axis=1)
    return int(inside[away.argmin()])
