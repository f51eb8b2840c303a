"""What localisation says: where one image was taken in a map, and which place the robot is at now."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from shared.geometry import FloatArray, IntArray
from station.model.place_map import DOOR_TO, ROOM_SEPARATOR

PlaceState = Literal["known", "unknown", "lost"]


@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """One image, found in a map by geometry: verified, or it would not exist. Look-alikes may give it several."""

    t_robot_ns: int
    T_map_cam: FloatArray  # (4, 4)
    num_inliers: int
    inlier_ratio: float
    sigma_position: float  # map units, 1 sigma per axis
    keyframe_index: int  # the map's keyframe with the most inliers: the evidence image
    map_id: str
    extent: float  # map units: median distance of the recognised landmarks from their middle
    num_features: int  # of the image
    landmarks: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (i,) of the map, recognised


@dataclass(frozen=True, slots=True)
class PlaceCandidate:
    """One place and how probable it is that the robot is nearest to it, ties within 10 % of the distance included.

    Near the border of two places both are right, so that the probabilities of several may sum to more than one.
    """

    id: str
    name: str
    probability: float
    room: str | None = None  # id of the room it is in


@dataclass(frozen=True, slots=True)
class RoomCandidate:
    """One room and how probable it is that the robot is in it, or as good as in its doorway.

    In a doorway both rooms are right, so that the probabilities of two may sum to more than one.
    """

    id: str
    name: str
    probability: float


def is_elsewhere(place_room: str | None, room: str | None) -> bool:
    """Whether a place belongs to another room than this one, which is named; neither may be known. Ids.

    It may be nearest all the same, behind a door or a thin wall.
    """
    return None not in (place_room, room) and place_room != room


def where(place: str, room: str, is_elsewhere: bool = False) -> str:
    """Names of the place and the room in words, each empty where it is not known: "at Sofa in Living room".

    A place that is called after its room says the room already. The nearest place may be another room's
    (`is_elsewhere`): then it is left out, or tells of the door between both: "in Hall, near the door to Kitchen".
    """
    if not (place and room):
        return f"at {place}" if place else f"in {room}" if room else ""
    if is_elsewhere:
        behind = place.removesuffix(f"{ROOM_SEPARATOR}{DOOR_TO} {room}")
        return f"in {room}" if behind == place else f"in {room}, near the door to {behind}"
    return f"at {place}" if place == room or place.startswith(room + ROOM_SEPARATOR) else f"at {place} in {room}"


@dataclass(frozen=True, slots=True, eq=False)
class PlaceAnswer:
    """The current place. `place` is None unless state is "known"; the room is often known before the place."""

    state: PlaceState
    place: PlaceCandidate | None
    distance: float | None  # robot to centroid, map units
    position_map: FloatArray | None  # (3,) the robot's body
    t_robot_ns: int  # time the answer is about, by the IMU's clock: a picture's with the camera's time shift
    evidence_t_robot_ns: int | None  # sensor time of the last verified localisation
    evidence_keyframe: int | None
    inliers: int
    alternatives: tuple[PlaceCandidate, ...]
    reason: str  # a sentence for a person
    map_id: str | None = None  # of what is said of place, position and evidence; None: nothing speaks for any map
    room: RoomCandidate | None = None  # None: no room is probable enough
    room_alternatives: tuple[RoomCandidate, ...] = ()  # the likeliest other ones; all of them while `room` is None
    one_of_two: tuple[RoomCandidate, ...] = ()  # while `room` is None: the two that it is surely one of, or none
    doorway: str | None = None  # id of the door that the robot is in
    forward_map: FloatArray | None = None  # (3,) unit vector, where the robot's front points; where there is a position
    sigma_position: float | None = None  # map units, 1 sigma per axis of the position
    is_withheld: bool = False  # place and room would not be told if they were known: doubt position and probabilities

    def withheld(self, why: str) -> PlaceAnswer:
        """Place and room are but likely, the position stays. Its words stay where it is sure of neither."""
        if self.state != "known" and self.room is None and not self.one_of_two:
            return replace(self, is_withheld=True)
        place = () if self.place is None else (self.place,)
        room = () if self.room is None else (self.room,)
        return replace(
            self,
            state="unknown" if self.state == "known" else self.state,
            place=None,
            distance=None,
            alternatives=(*place, *self.alternatives),
            reason=why,
            room=None,
            room_alternatives=(*room, *self.room_alternatives),
            one_of_two=(),
            doorway=None,
            is_withheld=True,
        )


HijackCue = Literal["imu", "vision", "position"]


@dataclass(frozen=True, slots=True)
class HijackEvent:
    """Somebody moved the robot."""

    t_robot_ns: int
    cue: HijackCue
    reason: str  # a few words for a person
    confidence: float  # 0..1, what CurrentPlaceEstimator.on_hijack takes


@dataclass(frozen=True, slots=True)
class MapReading:
    """How far the worker is with the maps that it was given."""

    fraction: float  # 0..1
    text: str


@dataclass(frozen=True, slots=True)
class MapLeftOut:
    """One of several maps that cannot be read; the robot is looked for in the others."""

    map_id: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class PlaceReport:
    """The current place, and how the last picture was found."""

    map_id: str  # whose frame positions are in: where the robot is, or the first map while nobody knows
    answer: PlaceAnswer
    T_map_cam: FloatArray | None  # (4, 4) of the picture the answer is about, when it was found in this map
    t_evidence_ns: int | None  # what the answer's evidence_t_robot_ns is while it rests on this picture
    attempt: str  # what speaks for the picture's pose, or why there is none, in a sentence
    num_hijacks: int = 0  # that the worker had noticed by then: an answer from before one says nothing of after it


@dataclass(frozen=True, slots=True, eq=False)
class HijackNotice:
    """The robot was picked up, and the current place since: whoever is told the one is told the other."""

    event: HijackEvent
    report: PlaceReport
