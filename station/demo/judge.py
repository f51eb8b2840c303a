"""Was the current place right? Compares the station's answers with the simulator's truth: judging only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import EstimationError
from shared.geometry import FloatArray, transform
from station.experiments.alignment import Alignment, align_points
from station.model.navigation import Trajectory

TIE = 1.10  # a place is right when no other is nearer by more than this factor: of two at equal distance both are
# What is asked of a run. A map of the wrong size gives routes of the wrong length, however right its places are;
# a robot that hardly ever knows its place is of no use, however right it is when it does.
MIN_RIGHT_OF_KNOWN = 0.9
MIN_KNOWN_OF_ANSWERS = 0.7
MAX_SCALE_ERROR = 0.03
DOORWAY_M = 0.5  # this near a room that is beside it: in a doorway both are right


@dataclass(frozen=True, slots=True)
class Sample:
    """One answer of `GET /place/current` while the robot drove."""

    t_robot_ns: int  # sensor time the answer is about
    state: str
    place_id: str | None
    probability: float
    position_map: tuple[float, float, float] | None = None
    room_id: str | None = None  # None: no room is known


@dataclass(frozen=True, slots=True)
class TrueRoom:
    """A room of the flat, an upright rectangle in the world."""

    name: str
    low: tuple[float, float]
    high: tuple[float, float]

    def beside_m(self, position: FloatArray) -> float:
        """How far a position lies outside of it; 0 inside."""
        low, high, p = np.array(self.low), np.array(self.high), position[:2]
        return float(np.linalg.norm(np.maximum(np.maximum(low - p, p - high), 0.0)))


@dataclass(frozen=True, slots=True)
class JudgedSample:
    """One answer beside the truth; what a person looks at when the demo fails."""

    t_robot_ns: int
    state: str
    place_id: str | None
    probability: float
    right: bool | None  # None: the answer named no place
    nearest_place_id: str  # by true position
    position_true: tuple[float, float, float]  # world frame, metres
    position_error_m: float | None  # of the position in the map; None where it named none
    room_right: bool | None = None  # None: the answer named no room


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the truth says of the answers."""

    answers: tuple[JudgedSample, ...]
    right: int
    wrong: int
    not_known: int
    final_known_right: bool
    first_known_right: bool | None
    seconds_to_first_known: float | None
    map_error_m: float  # RMS of the map's trajectory after alignment to the truth
    map_scale: float  # truth length per map length; 1 for a perfect metric map
    rooms_right: int = 0
    rooms_wrong: int = 0

    @property
    def passed(self) -> bool:
        """Whether everything was reached that is asked of a run."""
        return not self.shortfall

    @property
    def shortfall(self) -> str:
        """What was not reached, in words; empty when all was."""
        known = self.right + self.wrong
        checks = (
            (self.right >= MIN_RIGHT_OF_KNOWN * known, "more than one in ten of the known answers is wrong"),
            (
                self.rooms_right >= MIN_RIGHT_OF_KNOWN * (self.rooms_right + self.rooms_wrong),
                "more than one in ten of the rooms that were named is wrong",
            ),
            (self.answers[-1].room_right is not False, "the last answer names the wrong room"),
            (
                self.final_known_right,
                f"the last answer is {'wrong' if self.answers[-1].right is False else 'not known'}",
            ),
            (
                known >= MIN_KNOWN_OF_ANSWERS * len(self.answers),
                f"only {known} of {len(self.answers)} answers are known, fewer than {MIN_KNOWN_OF_ANSWERS:.0%}",
            ),
            (
                abs(self.map_scale - 1.0) <= MAX_SCALE_ERROR,
                f"the map's scale is {self.map_scale:.3f}, off by more than {MAX_SCALE_ERROR:.0%}",
            ),
        )
        return "; ".join(words for holds, words in checks if not holds)


def positions_at(log: Trajectory, t_robot_ns: FloatArray) -> FloatArray:
    """True body positions (N, 3) at the given robot times, linear in between."""
    t0 = log.t_robot_ns[0]
    t = (log.t_robot_ns - t0).astype(np.float64)
    wanted = t_robot_ns - float(t0)
    return np.stack([np.interp(wanted, t, log.T_world_body[:, i, 3]) for i in range(3)], axis=1)


def align_map(map_trajectory: Trajectory, log: Trajectory) -> Alignment:
    """From the map's frame to the world's, by where the mapping drive truly was; with the map's scale and error."""
    truth = positions_at(log, map_trajectory.t_robot_ns.astype(np.float64))
    return align_points(truth, map_trajectory.T_world_body[:, :3, 3], kind="sim3")


def carried(centroids_map: dict[str, FloatArray], T_world_map: FloatArray) -> dict[str, FloatArray]:
    """Where the places' centroids (3,) lie in the world."""
    return {name: transform(T_world_map, c[None])[0] for name, c in centroids_map.items()}


def is_right(place: str, centroids_true: dict[str, FloatArray], position_true: FloatArray) -> bool:
    """The answered place is the nearest one by true position, ties within 10 %."""
    distances = {name: float(np.linalg.norm(c - position_true)) for name, c in centroids_true.items()}
    return place in distances and distances[place] <= TIE * min(distances.values())


def true_rooms_of(
    middles_map: Mapping[str, FloatArray], rooms: Sequence[TrueRoom], T_world_map: FloatArray
) -> dict[str, TrueRoom]:
    """Of the map's rooms, by a free spot (3,) in the middle of each: the flat's room it is in."""
    if not rooms:
        return {}
    where = carried(dict(middles_map), T_world_map)
    return {room_id: min(rooms, key=lambda room: room.beside_m(p)) for room_id, p in where.items()}


def is_room_right(room_id: str | None, true_rooms: Mapping[str, TrueRoom], position_true: FloatArray) -> bool | None:
    """Whether the robot is in the room that was named, or in a doorway of it. None: no room was named."""
    if room_id is None:
        return None
    return room_id in true_rooms and true_rooms[room_id].beside_m(position_true) <= DOORWAY_M


def judge_sample(
    sample: Sample,
    position_true: FloatArray,
    centroids_true: dict[str, FloatArray],
    T_world_map: FloatArray,
    true_rooms: Mapping[str, TrueRoom],
) -> JudgedSample:
    """Whether an answer names the place that is nearest in truth, and its room, and how far its position is off."""
    nearest = min(centroids_true, key=lambda name: float(np.linalg.norm(centroids_true[name] - position_true)))
    right = is_right(sample.place_id or "", centroids_true, position_true) if sample.state == "known" else None
    error_m = None
    if sample.position_map is not None:
        found = transform(T_world_map, np.array([sample.position_map]))[0]
        error_m = round(float(np.linalg.norm(found - position_true)), 3)
    x, y, z = (round(float(v), 3) for v in position_true)
    room_right = is_room_right(sample.room_id, true_rooms, position_true)
    return JudgedSample(
        sample.t_robot_ns, sample.state, sample.place_id, sample.probability, right, nearest, (x, y, z), error_m,
        room_right,
    )  # fmt: skip


def judge(
    map_trajectory: Trajectory,
    centroids_map: dict[str, FloatArray],
    log: Trajectory,
    samples: list[Sample],
    start_ns: int,
    middles_map: Mapping[str, FloatArray] | None = None,
    rooms: Sequence[TrueRoom] = (),
) -> Verdict:
    """Judge the samples taken after `start_ns` (robot clock: when the robot was put down again).

    Args:
        map_trajectory: body poses of the mapping drive, map frame.
        centroids_map: place id -> (3,) centroid, map frame.
        log: the simulator's truth over both drives.
        middles_map: room id -> (3,) a free spot in its middle, map frame.
        rooms: those of the flat.
    Raises:
        EstimationError: there is no such sample.
    """
    aligned = align_map(map_trajectory, log)
    T = aligned.T_target_source
    centroids_true = carried(centroids_map, T)
    after = [s for s in samples if s.t_robot_ns >= start_ns]
    if not after:
        raise EstimationError("the station gave no answer after the hijack")
    where = positions_at(log, np.array([s.t_robot_ns for s in after], dtype=np.float64))
    true_rooms = true_rooms_of(middles_map or {}, rooms, T)
    answers = tuple(judge_sample(s, p, centroids_true, T, true_rooms) for s, p in zip(after, where, strict=True))
    known = [a for a in answers if a.right is not None]
    return Verdict(
        answers=answers,
        right=sum(a.right is True for a in known),
        wrong=sum(a.right is False for a in known),
        not_known=len(answers) - len(known),
        final_known_right=answers[-1].right is True,
        first_known_right=known[0].right if known else None,
        seconds_to_first_known=(known[0].t_robot_ns - start_ns) * 1e-9 if known else None,
        map_error_m=aligned.rms,
        map_scale=aligned.scale,
        rooms_right=sum(a.room_right is True for a in answers),
        rooms_wrong=sum(a.room_right is False for a in answers),
    )
