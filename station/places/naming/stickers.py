"""Stickers and door plates with a code, seen in the keyframes of a map: which room each hangs in."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from shared.geometry import FloatArray, IntArray, homogeneous, transform
from shared.room_sticker import CODE_SIDE_M, is_ours, room_named_by
from station.model.floor_plan import FloorPlan, NameSuggestion
from station.model.frames import decode_picture
from station.model.navigation import Landmarks
from station.model.place_map import PlaceMap
from station.places.naming.facing import room_before
from station.vision.codes import read_codes
from station.vision.lens import Lens

MAX_PICTURES = 2000  # evenly spread over a larger map: 10 ms each
OWN_TRUST, PLAIN_TRUST = 0.99, 0.5  # of a code that says it names a room, and of any other text
MIN_LANDMARKS = 4  # on a sticker: their median depth then survives one wrong landmark
# One sigma of a distance: landmarks are as good as the map; a printed size is off by what printers shrink a page (3 to
# 6 %) and by half a pixel of a code that is 60 px wide.
LANDMARK_SIGMA, SIZE_SIGMA = 0.03, 0.06
ONE_STICKER_M = 0.6  # sightings of one text that are closer than this, or than their sigmas, are of one sticker


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One code in one keyframe. Lengths in map units."""

    name: str
    is_ours: bool
    keyframe_index: int
    corners_px: FloatArray  # (4, 2)
    p_map: FloatArray  # (3,) its middle
    p_camera_map: FloatArray  # (3,)
    sigma: float  # of the distance between the two


def stickers_in(place_map: PlaceMap, plan: FloorPlan) -> tuple[NameSuggestion, ...]:
    """Names that stickers in the map's pictures give to rooms of the plan."""
    return suggestions(find_stickers(place_map, plan.unit), plan)


def find_stickers(place_map: PlaceMap, unit: float) -> list[Sighting]:
    """All codes in the keyframes that name a room and whose distance is known. `unit`: map units per metre."""
    navigation = place_map.navigation
    keyframes, landmarks = navigation.keyframes, navigation.landmarks
    if navigation.calibration.camera is None:
        return []
    lens = Lens(navigation.calibration.camera)
    rows = landmarks.observations_by_keyframe(len(keyframes))
    found = []
    step = max(1, -(-len(keyframes) // MAX_PICTURES))
    for k in range(0, len(keyframes), step):
        try:
            grey = decode_picture(keyframes.encoded[k], cv2.IMREAD_GRAYSCALE)
        except ValueError:
            continue  # a damaged picture is reported where maps are checked
        T = keyframes.T_world_cam[k]
        for code in read_codes(grey):
            name = room_named_by(code.text)
            known_side = CODE_SIDE_M * unit if navigation.is_metric and is_ours(code.text) else None
            if name is None or (at := _place(lens, code.corners_px, known_side, landmarks, rows[k], T)) is None:
                continue
            p_cam, sigma = at
            p_map = transform(T, p_cam[None])[0]
            found.append(Sighting(name, is_ours(code.text), k, code.corners_px, p_map, T[:3, 3], sigma))
    return found


def _place(
    lens: Lens, corners_px: FloatArray, side: float | None, landmarks: Landmarks, rows: IntArray, T: FloatArray
) -> tuple[FloatArray, float] | None:
    """Where a code is (3,), camera frame, and the sigma of its distance: by the landmarks on it, else by its size."""
    corners = lens.unproject(corners_px)
    ray = homogeneous(_middle(corners)[None])[0]
    uv = landmarks.observed_uv_px[rows]
    inside = [cv2.pointPolygonTest(corners_px.astype(np.float32), p, False) >= 0 for p in uv.tolist()]
    on_it = landmarks.observed_landmark[rows[np.asarray(inside, dtype=bool)]]
    if len(on_it) >= MIN_LANDMARKS:
        depth = float(np.median((landmarks.p_world[on_it] - T[:3, 3]) @ T[:3, 2]))
        if depth > 0:
            return ray * depth, LANDMARK_SIGMA * depth * float(np.linalg.norm(ray))
    if side is None:
        return None
    square = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * (side / 2)
    ok, _, t = cv2.solvePnP(square, corners, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    if not ok or t[2, 0] <= 0:
        return None
    return np.asarray(t, dtype=np.float64).reshape(3), SIZE_SIGMA * float(np.linalg.norm(t))


def _middle(corners: FloatArray) -> FloatArray:
    """(2,) where the diagonals of a quadrilateral (4, 2) cross: the image of a square's middle."""
    a, b, c, d = homogeneous(corners)
    p = np.cross(np.cross(a, c), np.cross(b, d))
    return np.asarray(p[:2] / p[2])


def suggestions(sightings: Iterable[Sighting], plan: FloorPlan) -> tuple[NameSuggestion, ...]:
    """One suggestion per room and name. A sticker that seems to hang in two rooms names that of its nearest view.

    Where the plan may have joined two rooms the sticker names one of them, and nobody knows which: no suggestion is
    surer than the plan is of the room.
    """
    by_room: dict[int, dict[str, list[Sighting]]] = defaultdict(dict)
    for group in _one_sticker_each(sightings, plan.unit):
        votes: dict[int, list[Sighting]] = defaultdict(list)
        for sighting in group:
            room = room_before(plan, sighting.p_map, sighting.p_camera_map, sighting.sigma)
            if room is not None:
                votes[room].append(sighting)
        if not votes:
            continue
        room = min(votes, key=lambda r: min(s.sigma for s in votes[r]))  # the nearest view knows best
        by_room[room].setdefault(votes[room][0].name, []).extend(votes[room])
    return tuple(
        _suggestion(plan, room, name, seen, share=1 / len(names))
        for room, names in sorted(by_room.items())
        for name, seen in sorted(names.items())
        if name != plan.rooms[room].name
    )


def _one_sticker_each(sightings: Iterable[Sighting], unit: float) -> list[list[Sighting]]:
    """Sightings of one text near each other: a flat may have two stickers that read alike."""
    groups: list[list[Sighting]] = []
    for sighting in sorted(sightings, key=lambda s: s.sigma):
        for group in groups:
            apart = float(np.linalg.norm(group[0].p_map - sighting.p_map))
            if group[0].name == sighting.name and apart < ONE_STICKER_M * unit + 2 * sighting.sigma:
                group.append(sighting)
                break
        else:
            groups.append([sighting])
    return groups


def _suggestion(plan: FloorPlan, room: int, name: str, seen: list[Sighting], share: float) -> NameSuggestion:
    clearest = min(seen, key=lambda s: s.sigma)
    distance_m = float(np.linalg.norm(clearest.p_map - clearest.p_camera_map)) / plan.unit
    pictures = "one picture" if len(seen) == 1 else f"{len(seen)} pictures"
    return NameSuggestion(
        room=plan.rooms[room].id,
        name=name,
        source="sticker",
        confidence=share * plan.rooms[room].certainty * (OWN_TRUST if any(s.is_ours for s in seen) else PLAIN_TRUST),
        reason=f'A sticker that reads "{name}" hangs here: {pictures} show it, the nearest from {distance_m:.1f} m.',
        keyframe_index=clearest.keyframe_index,
        corners_px=clearest.corners_px,
        p_map=clearest.p_map,
    )
