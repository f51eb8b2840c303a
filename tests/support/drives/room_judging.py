"""What the answers about the current room are worth, by the map's own rooms at where the robot truly was.

Whether the walls between them stand right is judged elsewhere (benchmarks/room_truth.py). As for places, in a doorway
both rooms are right, and what is unmapped is the room that was left out of the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from station.experiments.calibration_curve import calibration_bins, calibration_error
from station.model.place_map import PlaceMap
from station.places.tracking.room_view import RoomView
from tests.support.drives.judging import Share, where_taken
from tests.support.drives.playback import Played
from tests.support.drives.recorded import RecordedDrive


@dataclass(frozen=True, slots=True)
class JudgedRoom:
    """An answer's room beside the truth."""

    is_known: bool
    is_right: bool  # of a known one, and of others false
    in_room: bool  # truly in a room of the map
    is_unmapped: bool  # truly where the map has nothing
    probability: float  # of the named room, 0 where none is


@dataclass(frozen=True, slots=True)
class RoomDrive:
    rooms: tuple[JudgedRoom, ...]
    found_again_s: float | None  # a right room after being put down in a mapped one; None: never, or no such hijack
    was_put_down: bool  # in a mapped room


def judge_rooms(place_map: PlaceMap, drive: RecordedDrive, played: Played) -> RoomDrive:
    """All answers of one drive in a map with a plan."""
    view = RoomView.of(place_map.plan)
    camera, hijack = drive.calibration.camera, drive.hijack
    shift_ns = round(1e9 * camera.time_shift_s) if camera else 0
    judged: list[JudgedRoom] = []
    since_s: list[float] = []
    for image, answer in played.answers:
        where = where_taken(image)
        if where in ("doorway", "hand"):
            continue
        inside = tied = np.zeros(0)
        if view is not None and image.T_map_body is not None and where == "mapped":
            inside, tied = view.shares(image.T_map_body[:3, 3][None])
        right = () if view is None else [r.id for r, t in zip(view.plan.rooms, tied, strict=False) if t > 0]
        is_right = answer.room is not None and answer.room.id in right
        judged.append(
            JudgedRoom(
                answer.room is not None,
                is_right,
                bool(inside.any()),
                where == "unmapped",
                answer.room.probability if answer.room is not None else 0.0,
            )
        )
        if hijack is not None and is_right and image.t_robot_ns + shift_ns >= hijack.put_down_ns:
            since_s.append((image.t_robot_ns + shift_ns - hijack.put_down_ns) / 1e9)
    was_put_down = hijack is not None and not hijack.to_unmapped
    return RoomDrive(tuple(judged), min(since_s, default=None) if was_put_down else None, was_put_down)


@dataclass(frozen=True, slots=True)
class RoomSummary:
    precision: Share  # of all rooms that were named: right
    known: Share  # of the answers truly in a mapped room: a room was named
    silent: Share  # of the answers in a room that no map knows: none was named
    calibration_error: float
    found_again_s: float | None  # median of the hijacks to mapped rooms; infinite where half never were


def summarise_rooms(drives: Sequence[RoomDrive]) -> RoomSummary:
    """Over all answers of all drives."""
    rooms = [room for drive in drives for room in drive.rooms]
    known = [room for room in rooms if room.is_known]
    inside, unmapped = [r for r in rooms if r.in_room], [r for r in rooms if r.is_unmapped]
    found = [np.inf if d.found_again_s is None else d.found_again_s for d in drives if d.was_put_down]
    return RoomSummary(
        precision=Share(sum(r.is_right for r in known), len(known)),
        known=Share(sum(r.is_known for r in inside), len(inside)),
        silent=Share(sum(not r.is_known for r in unmapped), len(unmapped)),
        calibration_error=calibration_error(calibration_bins((r.probability, r.is_right) for r in known)),
        found_again_s=float(np.median(found)) if found else None,
    )
