"""Answers of the current place, judged by true poses. Judges only; nothing estimates with this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, transform
from station.datasets import Dataset
from station.experiments.alignment import align_most_points, align_poses
from station.experiments.calibration_curve import Bin, calibration_bins, calibration_error
from station.experiments.evaluation import truth_of_body
from station.model.floor_plan import FloorPlan
from station.model.navigation import Navigation
from station.model.place_answer import PlaceAnswer
from station.model.place_map import Place, PlaceMap
from station.motion.interpolation import interpolate_poses
from station.places.tracking.room_view import RoomView

TIE = 1.1  # so many times the distance of the nearest place: as near, so right too
LEVER_M = 1.0  # a true position is good to one or two centimetres, an orientation to as much at this distance
MAX_MISFIT = 0.5  # of the path's own spread: poses of another drive leave about all of it, of a bent map a tenth
MIN_POSITIONS = 15  # of answers that the map's frame is fitted to: a similarity takes seven numbers from them
FOLDS = 5

TruthSource = Literal["map", "answers", "none"]


@dataclass(frozen=True, slots=True, eq=False)
class MapFrame:
    """How the truth's world lies in the map's frame."""

    source: TruthSource  # "map": the mapping drive's true poses; "answers": fitted to what is judged; "none": unknown
    T_map_truth: FloatArray  # (N, 4, 4) for each answer, upper-left 3x3 is scale * R; NaN where unknown
    why: str = ""  # where it is unknown: a sentence


@dataclass(frozen=True, slots=True, eq=False)
class JudgedAnswers:
    """Answers, in order, and what truth says of each."""

    answers: tuple[PlaceAnswer, ...]
    frame: MapFrame
    has_truth: np.typing.NDArray[np.bool_]  # (N,) a true position in the map is known
    is_right: np.typing.NDArray[np.bool_]  # (N,) "known", and the place is nearest to the true position
    position_error_m: FloatArray  # (N,) NaN where there is no position or no truth
    in_room: np.typing.NDArray[np.bool_] | None = None  # (N,) truly in a room of the map; None: it has no rooms
    is_room_right: np.typing.NDArray[np.bool_] | None = None  # (N,) that room was named, or the one behind a doorway

    @property
    def is_judged(self) -> np.typing.NDArray[np.bool_]:
        """(N,) "known", with a truth to judge it."""
        return np.array([a.state == "known" for a in self.answers], dtype=bool) & self.has_truth

    def bins(self) -> tuple[Bin, ...]:
        """Of the judged answers: probabilities, and the shares that were right."""
        return calibration_bins(
            (a.place.probability, bool(right))
            for a, right, judged in zip(self.answers, self.is_right, self.is_judged, strict=True)
            if judged and a.place is not None
        )

    def summary(self) -> dict[str, float | int | str | None]:
        """CONTRACT: `summary.json`. What is not known is None; `right` and `wrong` are of the judged answers."""
        states = [answer.state for answer in self.answers]
        judged, asked, right = int(self.is_judged.sum()), int(self.has_truth.sum()), int(self.is_right.sum())
        errors = self.position_error_m[np.isfinite(self.position_error_m)]
        return {
            "answers": len(states),
            "known": states.count("known"),
            "unknown": states.count("unknown"),
            "lost": states.count("lost"),
            "right": right if asked else None,
            "wrong": judged - right if asked else None,
            "precision": right / judged if judged else None,
            "recall": right / asked if asked else None,
            "position_error_median_m": float(np.median(errors)) if len(errors) else None,
            "calibration_error": calibration_error(self.bins()) if judged else None,
            "truth": self.frame.source,
            "answers_with_truth": asked,
            **self._room_summary(),
        }

    def _room_summary(self) -> dict[str, float | int | str | None]:
        """Rooms are the map's own: whether its walls stand right is not judged here."""
        if self.in_room is None or self.is_room_right is None or not self.has_truth.any():
            return dict.fromkeys(("room_known", "room_right", "room_precision", "room_recall"))
        named = np.array([a.room is not None for a in self.answers], dtype=bool) & self.has_truth
        known, right, asked = int(named.sum()), int(self.is_room_right.sum()), int(self.in_room.sum())
        return {
            "room_known": known,
            "room_right": right,
            "room_precision": right / known if known else None,
            "room_recall": int((self.is_room_right & self.in_room).sum()) / asked if asked else None,
        }


def judge_recorded(
    answers: Sequence[PlaceAnswer], place_map: PlaceMap, recorded: Dataset, mapping: Dataset | None = None
) -> JudgedAnswers:
    """Judge the answers to a recording by its true poses; without any, nothing is right or wrong.

    Args:
        mapping: what the map was made from; its true poses give the map's frame, else the answers themselves do.
    Raises:
        As `frame_of_map`, of the mapping dataset.
    """
    p_true = true_positions(answers, recorded)
    if recorded.truth is None:
        nowhere = np.full((len(answers), 4, 4), np.nan)
        frame = MapFrame("none", nowhere, f"{recorded.path} holds no true poses")
    elif mapping is None:
        frame = frame_of_answers(answers, p_true)
    else:
        frame = frame_of_map(place_map.navigation, mapping, len(answers))
    return judge_answers(answers, place_map.places, p_true, frame, place_map.plan)


def judge_answers(
    answers: Sequence[PlaceAnswer],
    places: Sequence[Place],
    p_true: FloatArray,
    frame: MapFrame,
    plan: FloorPlan | None = None,
) -> JudgedAnswers:
    """Judge each answer by the place nearest to where the robot truly was; ties within 10 % are right too.

    Args:
        p_true: (N, 3) true positions of the body, truth's world, NaN where unknown.
    """
    p_map = np.array([transform(T, p[None])[0] for T, p in zip(frame.T_map_truth, p_true, strict=True)]).reshape(-1, 3)
    has_truth = np.isfinite(p_map).all(axis=1)
    units_per_m = np.linalg.norm(frame.T_map_truth[:, :3, 0], axis=1)  # the scale, also NaN where unknown
    said = np.array([np.full(3, np.nan) if a.position_map is None else a.position_map for a in answers]).reshape(-1, 3)
    is_right = [
        bool(true) and a.state == "known" and a.place is not None and a.place.id in nearest_places(places, p)
        for a, p, true in zip(answers, p_map, has_truth, strict=True)
    ]
    error_m = np.linalg.norm(said - p_map, axis=1) / units_per_m
    judged = JudgedAnswers(tuple(answers), frame, has_truth, np.array(is_right, dtype=bool), error_m)
    rooms = RoomView.of(plan)
    if rooms is None:
        return judged
    in_room, is_room_right = np.zeros((2, len(judged.answers)), dtype=bool)
    number = {room.id: i for i, room in enumerate(rooms.plan.rooms)}
    for k in np.flatnonzero(has_truth):
        inside, tied = rooms.shares(p_map[k][None])
        room = judged.answers[k].room
        in_room[k] = inside.any()
        is_room_right[k] = room is not None and room.id in number and tied[number[room.id]] > 0
    return replace(judged, in_room=in_room, is_room_right=is_room_right)


def nearest_places(places: Sequence[Place], p_map: FloatArray) -> set[str]:
    """Ids of the places whose centroids are nearest to a position (3,), ties within 10 % included."""
    distance = np.array([float(np.linalg.norm(place.centroid_map - p_map)) for place in places])
    return {place.id for place, d in zip(places, distance, strict=True) if d <= TIE * distance.min()}


def true_positions(answers: Sequence[PlaceAnswer], data: Dataset) -> FloatArray:
    """(N, 3) where the body truly was at each answer's time, NaN where that is not known.

    Answers and truth are both by the IMU's clock: the tracker has added the camera's time shift.
    """
    p = np.full((len(answers), 3), np.nan)
    if data.truth is not None and answers:
        T, known = interpolate_poses(data.truth, np.array([answer.t_robot_ns for answer in answers], dtype=np.int64))
        p[known] = T[:, :3, 3]
    return p


def frame_of_map(navigation: Navigation, mapping: Dataset, num_answers: int) -> MapFrame:
    """From the true poses of the drive that the map was made from.

    Raises:
        DataError: the dataset has no true poses.
        DegenerateGeometry: map and dataset have too few times in common, the body did not move, or the poses are of
            another drive: folders of images all begin at time zero.
    """
    T_truth, kept = interpolate_poses(truth_of_body(navigation, mapping), navigation.trajectory.t_robot_ns)
    T_map = navigation.trajectory.T_world_body[kept]
    found = align_poses(T_map, T_truth, LEVER_M)
    if found.rms > MAX_MISFIT * float(np.linalg.norm(T_map[:, :3, 3].std(axis=0))):
        raise DegenerateGeometry("its true poses are of another drive")
    return MapFrame("map", np.tile(found.T_target_source, (num_answers, 1, 1)))


def frame_of_answers(answers: Sequence[PlaceAnswer], p_true: FloatArray) -> MapFrame:
    """Fitted to the answers' own positions; "none" where there are too few.

    What is judged must not have been fitted: the answers are cut into FOLDS stretches of time, and each is judged in a
    frame that the others gave. An error that all answers share (the map's twin room) stays hidden all the same.
    """
    frames = np.full((len(answers), 4, 4), np.nan)
    said = np.array([np.full(3, np.nan) if a.position_map is None else a.position_map for a in answers]).reshape(-1, 3)
    usable = np.flatnonzero(np.isfinite(said).all(axis=1) & np.isfinite(p_true).all(axis=1))
    if len(usable) < MIN_POSITIONS:
        return MapFrame("none", frames, f"{len(usable)} answers have a position and a true one, {MIN_POSITIONS} needed")
    fold = np.searchsorted(usable[np.linspace(0, len(usable), FOLDS + 1)[1:-1].astype(int)], np.arange(len(answers)),
                           side="right")  # fmt: skip
    try:
        for k in range(FOLDS):
            others = usable[fold[usable] != k]
            frames[fold == k] = align_most_points(said[others], p_true[others]).T_target_source
    except DegenerateGeometry as exc:
        return MapFrame("none", np.full_like(frames, np.nan), str(exc))
    return MapFrame("answers", frames)
