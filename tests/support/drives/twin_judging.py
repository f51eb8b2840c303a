"""What is said of the room while the robot is in one of two twin rooms, both in the map, that it was put down in.

Judged are the answers from when it was put down to when it first leaves the room. A *guess* names another room than the
one it is in. *One of two* names none, and the two likeliest rooms are the true one and its twin. By the map's own rooms
at the true spot and at the same spot of the twin; whether walls stand right is judged elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from shared.geometry import FloatArray
from station.model.place_answer import PlaceAnswer
from station.model.place_map import PlaceMap
from station.places.tracking.room_view import RoomView
from tests.support.drives.judging import Share, right_places
from tests.support.drives.playback import Played
from tests.support.drives.recorded import RecordedDrive

Said = Literal["right", "guess", "one of two", "nothing"]


@dataclass(frozen=True, slots=True)
class TwinAnswer:
    since_s: float  # since the robot was put down
    said: Said
    probability: float  # of the room that was named; of both together for "one of two", else 0
    is_place_wrong: bool  # a place was named that is not the nearest one


@dataclass(frozen=True, slots=True)
class TwinDrive:
    name: str
    answers: tuple[TwinAnswer, ...]  # while in the room that it was put down in


def judge_twins(place_map: PlaceMap, drive: RecordedDrive, played: Played) -> TwinDrive:
    """All answers of one drive in a map with a plan; none without a hijack to a twin room."""
    view = RoomView.of(place_map.plan)
    answers: list[TwinAnswer] = []
    if view is not None:
        for since_s, p_map, p_twin, answer in _in_twin(drive, played):
            here, there = _rooms_at(view, p_map), _rooms_at(view, p_twin)
            is_wrong = answer.place is not None and answer.place.id not in right_places(place_map, p_map)
            answers.append(TwinAnswer(since_s, *_said(answer, here, there), is_wrong))
    return TwinDrive(drive.name, tuple(answers))


def _in_twin(drive: RecordedDrive, played: Played) -> Iterator[tuple[float, FloatArray, FloatArray, PlaceAnswer]]:
    """Answers in the room that the robot was put down in, until it leaves: seconds after, where (3,) it is there and in
    the room's twin."""
    camera = drive.calibration.camera
    shift_ns = round(1e9 * camera.time_shift_s) if camera else 0
    for image, answer in played.answers:
        if drive.hijack is None or image.t_robot_ns + shift_ns < drive.hijack.put_down_ns:
            continue
        if image.T_map_body is None or image.T_map_twin is None:
            return
        since_s = (image.t_robot_ns + shift_ns - drive.hijack.put_down_ns) / 1e9
        yield since_s, image.T_map_body[:3, 3], image.T_map_twin[:3, 3], answer


def _rooms_at(view: RoomView, p_map: FloatArray) -> set[str]:
    """Ids of the map's rooms at a position (3,): two in a doorway."""
    _, tied = view.shares(p_map[None])
    return {room.id for room, share in zip(view.plan.rooms, tied, strict=True) if share > 0}


def _said(answer: PlaceAnswer, here: set[str], there: set[str]) -> tuple[Said, float]:
    if answer.room is not None:
        return ("right" if answer.room.id in here else "guess"), answer.room.probability
    two = answer.one_of_two
    if any(room.id in here for room in two) and any(room.id in there - here for room in two):
        return "one of two", sum(room.probability for room in two)
    return "nothing", 0.0


@dataclass(frozen=True, slots=True)
class TwinSummary:
    """Over all answers in twin rooms that the robot was put down in, until it left them."""

    guessed: Share
    right: Share
    one_of_two: Share
    place_wrong: Share
    first_wrong: Share  # of the drives on which a room was named there: the first one was wrong


def summarise_twins(drives: Sequence[TwinDrive]) -> TwinSummary:
    answers = [a for drive in drives for a in drive.answers]

    def share(said: Said) -> Share:
        return Share(sum(a.said == said for a in answers), len(answers))

    named = [next((a for a in drive.answers if a.said in ("right", "guess")), None) for drive in drives]
    first = [a for a in named if a is not None]
    return TwinSummary(
        guessed=share("guess"),
        right=share("right"),
        one_of_two=share("one of two"),
        place_wrong=Share(int(np.count_nonzero([a.is_place_wrong for a in answers])), len(answers)),
        first_wrong=Share(sum(a.said == "guess" for a in first), len(first)),
    )
