"""SLAM and localisation that tests run in the station's worker processes; few imports, so that they start quickly."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from shared.calibration import Calibration
from shared.errors import EstimationError
from shared.geometry import FloatArray
from station.maps.store import MapStore
from station.model.calibration_fit import CalibrationFit, judge
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.map_store import StoreAddress
from station.model.navigation import Navigation
from station.model.place_answer import (
    HijackEvent,
    HijackNotice,
    PlaceAnswer,
    PlaceCandidate,
    PlaceReport,
    RoomCandidate,
)
from station.model.place_map import Grouping, PlaceMap
from station.model.slam_update import SlamUpdate
from station.places.making.changes import without_hidden
from station.places.rooms.edits import require_plan
from station.vision.features import Features
from station.workers.place_interface import PlaceEvent, PlaceProgram
from station.workers.request import Vectors
from tests.support.synthetic_home import drive, furnished_room, navigate


def focal_fit(scale: float) -> CalibrationFit:
    """Of a drive that knows the focal length well, and nothing else to say."""
    return judge((scale, 0.002), np.zeros(3), np.full(3, 0.2), (0.0, 0.001))


def turned_fit(degrees: float) -> CalibrationFit:
    """Of a drive that knows that the camera is turned, and that its focal length is right."""
    return judge((1.0, 0.002), np.array([degrees, 0.0, 0.0]), np.full(3, 0.2), (0.0, 0.001))


class StraightSlam:
    """A SlamBackend that takes every robot to drive straight on; ten landmarks per frame."""

    def __init__(self, calibration: Calibration) -> None:
        self.frames: list[ImageFrame] = []
        self.imu_samples = 0

    def add_imu(self, imu: ImuBatch) -> None:
        self.imu_samples += len(imu)

    def add_drive(self, drive: DriveSample) -> None:
        pass

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        self.frames.append(frame)
        T = np.eye(4)
        T[0, 3] = 0.01 * len(self.frames)
        points = len(self.frames) + 0.05 * np.arange(10.0)[:, None].repeat(3, axis=1)  # each in a cell of its own
        return SlamUpdate(frame.t_robot_ns, "tracking", "going straight", T, 10, False, points, points)

    def catch_up(self) -> bool:
        return False

    def keyframe_pictures(self) -> list[bytes]:
        return []

    def keyframe_features(self, number: int) -> Features | None:
        return None

    def finish(self) -> Navigation:
        if len(self.frames) < 3:
            raise EstimationError("fewer than 3 frames; drive longer")
        navigation = made_up_navigation()
        return replace(navigation, report=replace(navigation.report, frames=len(self.frames)))


class WitnessSlam(StraightSlam):
    """Says of every frame when the last inertial sample before it was taken."""

    last_imu_ns = 0

    def add_imu(self, imu: ImuBatch) -> None:
        self.last_imu_ns = int(imu.t_robot_ns[-1])

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        return replace(super().add_frame(frame), message=str(self.last_imu_ns))


class MisfitSlam(StraightSlam):
    """Finds the focal length 3 % too long."""

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        return replace(super().add_frame(frame), calibration_fit=focal_fit(0.97))


class FailingSlam(StraightSlam):
    """Ends its process when it is to finish."""

    def catch_up(self) -> bool:
        return False

    def finish(self) -> Navigation:
        os._exit(7)


class DyingSlam(StraightSlam):
    """Ends its process at the fifth frame."""

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        if len(self.frames) == 5:
            os._exit(7)
        return super().add_frame(frame)


class PlaceByLight(PlaceProgram):
    """Light pictures show the first map's first place, dark ones the last map's second one."""

    def __init__(self, emit: Callable[[PlaceEvent], None]) -> None:
        self._emit = emit
        self._maps: list[PlaceMap] = []
        self._was_dark = False
        self._num_hijacks = 0

    def load(self, store: StoreAddress, map_ids: tuple[str, ...]) -> None:
        self._maps = [without_hidden(MapStore(store).load(map_id)) for map_id in map_ids]

    def regroup(self, grouping: Grouping) -> None:
        assert self._maps[0].id == grouping.map_id
        self._maps[0] = without_hidden(grouping.applied_to(self._maps[0]))

    def calibrate(self, calibration: Calibration) -> None:
        pass

    def add_imu(self, t_robot_ns: Sequence[int], gyro: Vectors, accel: Vectors) -> None:
        pass

    def add_drive(self, sample: DriveSample) -> None:
        pass

    def add_pose(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int) -> None:
        pass

    def use_fit(self, fit: CalibrationFit | None) -> None:
        pass

    def answer(self, frame: ImageFrame) -> PlaceReport:
        t_robot_ns = frame.t_robot_ns
        is_dark = float(frame.grey().mean()) < 30.0
        is_moved = is_dark and not self._was_dark
        self._num_hijacks += is_moved
        self._was_dark = is_dark
        here = self._maps[-1 if is_dark else 0]
        first, second = here.places[1::-1] if is_dark else here.places[:2]
        report = PlaceReport(
            map_id=here.id,
            answer=PlaceAnswer(
                state="known",
                place=PlaceCandidate(first.id, first.name, 0.9),
                distance=0.5,
                position_map=first.centroid_map,
                t_robot_ns=t_robot_ns,
                evidence_t_robot_ns=t_robot_ns,
                evidence_keyframe=3,
                inliers=40,
                alternatives=(PlaceCandidate(second.id, second.name, 0.1),),
                reason="always here",
                map_id=here.id,
            ),
            T_map_cam=np.eye(4),
            t_evidence_ns=t_robot_ns,
            attempt="always found",
            num_hijacks=self._num_hijacks,
        )
        if is_moved:
            self._emit(HijackNotice(HijackEvent(t_robot_ns, "vision", "the light went out", 0.98), report))
        return report


class OneOfTwoRooms(PlaceByLight):
    """Every picture fits the first two rooms of the first map alike."""

    def answer(self, frame: ImageFrame) -> PlaceReport:
        report = super().answer(frame)
        two = zip(require_plan(self._maps[0]).rooms[:2], (0.5, 0.45), strict=True)
        rooms = tuple(RoomCandidate(room.id, room.name, probability) for room, probability in two)
        return replace(
            report, answer=replace(report.answer, state="lost", place=None, room_alternatives=rooms, one_of_two=rooms)
        )


class BehindAWall(PlaceByLight):
    """The nearest place is the first room's, and the robot is in the second."""

    def answer(self, frame: ImageFrame) -> PlaceReport:
        report = super().answer(frame)
        if report.answer.place is None:
            return report
        own, here = require_plan(self._maps[0]).rooms[:2]
        place = replace(report.answer.place, room=own.id)
        return replace(report, answer=replace(report.answer, place=place, room=RoomCandidate(here.id, here.name, 0.95)))


class InADoorway(PlaceByLight):
    """In the doorway between the first two rooms, at the place of the second."""

    def answer(self, frame: ImageFrame) -> PlaceReport:
        report = super().answer(frame)
        plan = require_plan(self._maps[0])
        first, second = (RoomCandidate(room.id, room.name, 0.95) for room in plan.rooms[:2])
        doorway = next(door.id for door in plan.doors if None not in door.rooms)
        return replace(
            report,
            answer=replace(report.answer, room=first, room_alternatives=(second,), doorway=doorway),
        )


def made_up_navigation() -> Navigation:
    home = furnished_room(3)
    return navigate(home, drive(home, 3), 3)
