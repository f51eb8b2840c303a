"""Names that hang in a map: a code or a printed word in one keyframe, where it is, and what it says of which room."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from shared.geometry import FloatArray, IntArray, homogeneous, transform
from station.model.floor_plan import FloorPlan, NameSuggestion, SuggestionSource
from station.model.navigation import Keyframes, Landmarks, Navigation
from station.places.naming.facing import room_before, room_named
from station.vision.lens import Lens

PLAIN_TRUST = 0.5  # of a text that does not say itself that it names a room: as likely as not
MIN_LANDMARKS = 4  # on what hangs there: their median depth then survives one wrong landmark
LANDMARK_SIGMA = 0.03  # one sigma of a distance by landmarks, which are as good as the map
ONE_THING_M = 0.6  # sightings of one text that are closer than this, or than their sigmas, are of one thing


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One text in one keyframe. Lengths in map units."""

    source: SuggestionSource
    name: str
    trust: float  # probability that it names a room, where it was read rightly
    keyframe_index: int
    corners_px: FloatArray  # (4, 2)
    p_map: FloatArray  # (3,) its middle
    p_camera_map: FloatArray  # (3,)
    sigma: float  # of the distance between the two

    def is_near(self, other: Sighting, unit: float) -> bool:
        """Whether both may be of one thing. `unit`: map units per metre."""
        apart = float(np.linalg.norm(other.p_map - self.p_map))
        return apart < ONE_THING_M * unit + 2 * max(self.sigma, other.sigma)


class Eye:
    """Where things are that keyframes of a navigation show."""

    def __init__(self, navigation: Navigation) -> None:
        assert navigation.calibration.camera is not None
        self.lens = Lens(navigation.calibration.camera)
        self._keyframes: Keyframes = navigation.keyframes
        self._landmarks: Landmarks = navigation.landmarks
        self._rows: list[IntArray] = self._landmarks.observations_by_keyframe(len(self._keyframes))

    def to_map(self, keyframe: int, p_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A point (3,) of a keyframe's camera frame in the map, and that camera."""
        T = self._keyframes.T_world_cam[keyframe]
        return transform(T, p_cam[None])[0], T[:3, 3]

    def by_landmarks(
        self, keyframe: int, corners_px: FloatArray, around_px: FloatArray
    ) -> tuple[FloatArray, float] | None:
        """Middle (3,) of a quadrilateral (4, 2), camera frame, and the sigma of its distance, by the landmarks in
        `around_px` (4, 2); None where these are too few.
        """
        rows, T = self._rows[keyframe], self._keyframes.T_world_cam[keyframe]
        uv = self._landmarks.observed_uv_px[rows]
        inside = [cv2.pointPolygonTest(around_px.astype(np.float32), p, False) >= 0 for p in uv.tolist()]
        on_it = self._landmarks.observed_landmark[rows[np.asarray(inside, dtype=bool)]]
        if len(on_it) < MIN_LANDMARKS:
            return None
        depth = float(np.median((self._landmarks.p_world[on_it] - T[:3, 3]) @ T[:3, 2]))
        if not depth > 0:
            return None
        ray = homogeneous(_middle(self.lens.unproject(corners_px))[None])[0]
        return ray * depth, LANDMARK_SIGMA * depth * float(np.linalg.norm(ray))


def _middle(corners: FloatArray) -> FloatArray:
    """(2,) where the diagonals of a quadrilateral (4, 2) cross: the image of a rectangle's middle."""
    a, b, c, d = homogeneous(corners)
    p = np.cross(np.cross(a, c), np.cross(b, d))
    return np.asarray(p[:2] / p[2])


def suggestions(sightings: Iterable[Sighting], plan: FloorPlan) -> tuple[NameSuggestion, ...]:
    """One suggestion per room, source and name. What seems to hang in two rooms names that of its nearest view.

    Where the plan may have joined two rooms what hangs there names one of them, and nobody knows which: no suggestion
    is surer than the plan is of the room. Several names by one source share their confidence.
    """
    by_room: dict[tuple[int, str], dict[str, list[Sighting]]] = defaultdict(dict)
    for group in _one_thing_each(sightings, plan.unit):
        votes: dict[int, list[Sighting]] = defaultdict(list)
        for s in group:
            room = room_named(plan, s.source, s.p_map, s.p_camera_map, s.sigma)
            if room is not None:
                votes[room].append(s)
        if not votes:
            continue
        room = min(votes, key=lambda r: min(s.sigma for s in votes[r]))  # the nearest view knows best
        first = votes[room][0]
        by_room[room, first.source].setdefault(first.name, []).extend(votes[room])
    return tuple(
        _suggestion(plan, room, seen, share=1 / len(names))
        for (room, _), names in sorted(by_room.items())
        for name, seen in sorted(names.items())
        if name.casefold() != plan.rooms[room].name.casefold()
    )


def _one_thing_each(sightings: Iterable[Sighting], unit: float) -> list[list[Sighting]]:
    """Sightings of one text near each other: a flat may have two stickers that read alike."""
    groups: list[list[Sighting]] = []
    for sighting in sorted(sightings, key=lambda s: s.sigma):
        for group in groups:
            if (group[0].source, group[0].name) == (sighting.source, sighting.name) and sighting.is_near(
                group[0], unit
            ):
                group.append(sighting)
                break
        else:
            groups.append([sighting])
    return groups


def _suggestion(plan: FloorPlan, room: int, seen: list[Sighting], share: float) -> NameSuggestion:
    clearest = min(seen, key=lambda s: s.sigma)
    distance_m = float(np.linalg.norm(clearest.p_map - clearest.p_camera_map)) / plan.unit
    pictures = "one picture shows it" if len(seen) == 1 else f"{len(seen)} pictures show it, the nearest"
    what = "A sticker" if clearest.source == "sticker" else "A printed word"
    is_here = room_before(plan, clearest.p_map, clearest.p_camera_map, clearest.sigma) == room
    where = "hangs here" if is_here else "hangs beside the door to here"
    return NameSuggestion(
        room=plan.rooms[room].id,
        name=clearest.name,
        source=clearest.source,
        confidence=share * plan.rooms[room].certainty * max(s.trust for s in seen),
        reason=f'{what} that reads "{clearest.name}" {where}: {pictures}, from {distance_m:.1f} m.',
        keyframe_index=clearest.keyframe_index,
        corners_px=clearest.corners_px,
        p_map=clearest.p_map,
    )
