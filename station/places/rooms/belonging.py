"""Which room a place belongs to: the one it was looked at from at hand, not the one behind its wall."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.geometry import FloatArray
from station.model.floor_plan import FloorPlan
from station.model.navigation import Navigation
from station.model.place_map import Place


def rooms_of_places(plan: FloorPlan, navigation: Navigation, places: Sequence[Place]) -> dict[str, str]:
    """Place id -> room id. A keyframe's say is its observations of the place, less with the square of the distance.

    Through a door a place is seen from afar. Where no observing keyframe is in a room, it is the room around it.
    """
    landmarks = navigation.landmarks
    centres = navigation.keyframes.T_world_cam[:, :3, 3]
    room_of_keyframe = plan.rooms_at(centres)
    place_of = np.full(len(landmarks), -1)
    for number, place in enumerate(places):
        place_of[place.landmark_index] = number
    votes = np.zeros((len(places), len(plan.rooms)))
    observed, keyframe = place_of[landmarks.observed_landmark], landmarks.observed_keyframe
    rows = np.flatnonzero((observed >= 0) & (room_of_keyframe[keyframe] >= 0))
    distance = _distances(landmarks.p_world[landmarks.observed_landmark[rows]] - centres[keyframe[rows]], plan.unit)
    np.add.at(votes, (observed[rows], room_of_keyframe[keyframe[rows]]), 1.0 / distance**2)
    found: dict[str, str] = {}
    for number, of in enumerate(places):
        if votes[number].any():
            found[of.id] = plan.rooms[int(votes[number].argmax())].id
        elif (room := int(plan.rooms_at(of.centroid_map[None])[0])) >= 0:
            found[of.id] = plan.rooms[room].id
    return found


def _distances(d: FloatArray, unit: float) -> FloatArray:
    """(n,) m; nearer than half a metre is at hand all the same, and what is not finite infinitely far."""
    length = np.linalg.norm(d, axis=1) / unit
    return np.where(np.isfinite(length), np.maximum(length, 0.5), np.inf)
