"""Which room a place belongs to: the one on whose side its landmarks are, wherever they were seen from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.model.floor_plan import NO_ROOM, FloorPlan
from station.model.navigation import Navigation
from station.model.place_map import Place
from station.places.rooms.lengths import WALL_M

REACH_M = 3 * WALL_M  # a room is looked for so far before a landmark: walls are as thick, and maps as wrong


def rooms_of_places(plan: FloorPlan, navigation: Navigation, places: Sequence[Place]) -> dict[str, str]:
    """Place id -> room id; places in no room of the plan have none.

    What is seen lies in the room that its sight comes from last. Of a wall's two faces each so belongs to its own side,
    and what is seen through a door to what is behind it. An observation counts less with the square of its distance:
    so much less surely is its landmark where the map has it. Where nobody observed a place, it is the room around it.
    """
    landmarks = navigation.landmarks
    place_of = np.full(len(landmarks), -1)
    for number, place in enumerate(places):
        place_of[place.landmark_index] = number
    p, centre = landmarks.p_world, navigation.keyframes.T_world_cam[:, :3, 3]
    is_asked = (place_of >= 0) & np.isfinite(p).all(axis=1)
    rows = np.flatnonzero(is_asked[landmarks.observed_landmark])
    observed, keyframe = landmarks.observed_landmark[rows], landmarks.observed_keyframe[rows]
    sight = centre[keyframe] - p[observed]
    length = np.maximum(np.linalg.norm(sight, axis=1), 1e-9)
    votes = np.zeros((len(places), len(plan.rooms) + 1))  # the last column is NO_ROOM's
    room = _last_rooms(plan, p[observed], sight / length[:, None], length)
    np.add.at(votes, (place_of[observed], room), 1.0 / np.maximum(length / plan.unit, 0.5) ** 2)
    found: dict[str, str] = {}
    for number, of in enumerate(places):
        if votes[number].any():
            room_number = int(votes[number].argmax())
        else:
            room_number = int(plan.rooms_at(of.centroid_map[None])[0])
        if room_number not in (NO_ROOM, len(plan.rooms)):
            found[of.id] = plan.rooms[room_number].id
    return found


def _last_rooms(plan: FloorPlan, p: FloatArray, back: FloatArray, length: FloatArray) -> IntArray:
    """(n,) numbers of the rooms nearest to p (n, 3) along the unit vectors `back`, NO_ROOM without one within reach.

    Asked for from the thickness of a wall before each point on, never behind the eye, which is so far (n,) away.
    """
    room = np.full(len(p), NO_ROOM, dtype=np.int64)
    for before in np.arange(WALL_M, REACH_M + 0.25 * WALL_M, 0.5 * WALL_M) * plan.unit:
        left = np.flatnonzero(room == NO_ROOM)
        room[left] = plan.rooms_at(p[left] + np.minimum(before, length[left])[:, None] * back[left])
    return room
