"""What runs in the worker that watches a calibration board, or an inertial unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from shared.calibration import CameraCalibration
from shared.errors import EstimationError
from station.calibration.boards import Finder, make_finder, view_board
from station.calibration.camera_imu.guide import WavingGuide
from station.calibration.guidance import Guidance, GuidedKind, TargetGuide
from station.calibration.guide import Guide
from station.calibration.imu.guide import StillGuide
from station.calibration.meter import read_meter
from station.calibration.target import BoardView, Target
from station.calibration.target_page import printed_target
from station.calibration.targetless.guide import LivelyGuide
from station.calibration.wheels_guide import WheelsGuide
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.workers.calibration_interface import BoardSeen, CalibrationProgram, MeterReading, PrintedBoard, Xyz


class BoardWatcher(CalibrationProgram):
    """Follows one guided calibration. A camera's meter is read again while no picture waits."""

    def __init__(self, emit: Callable[[None], None]) -> None:  # noqa: ARG002
        self._begun: tuple[Target, CameraCalibration, Finder, TargetGuide] | None = None
        self._feeling: StillGuide | LivelyGuide = StillGuide()
        self._meter: tuple[MeterReading, ...] = ()
        self._metered = 0  # how many views the meter has seen

    def begin(self, kind: GuidedKind, board: Target | PrintedBoard, camera: CameraCalibration) -> Target:
        target = board if isinstance(board, Target) else printed_target(board.kind, board.size, board.ruler_mm)
        self._begun = (target, camera, make_finder(target), _make_guide(kind, target, camera))
        return target

    def begin_without_board(self, kind: GuidedKind) -> None:
        self._feeling = LivelyGuide() if kind == "check" else StillGuide()

    def look(self, frame: ImageFrame) -> BoardSeen:
        target, _, finder, guide = self._require()
        view = view_board(finder, target, frame.grey(), frame.name, frame.t_robot_ns)
        return self._seen(frame.t_robot_ns, view, guide.look(view))

    def drive(self, samples: list[DriveSample]) -> None:
        guide = self._require()[3]
        if isinstance(guide, WheelsGuide):
            guide.drive(samples)

    def feel(self, t_robot_ns: list[int], gyro_imu: list[Xyz], accel_imu: list[Xyz]) -> BoardSeen:
        imu = ImuBatch(np.array(t_robot_ns), np.array(gyro_imu), np.array(accel_imu))
        return self._seen(t_robot_ns[-1], None, self._feeling.feel(imu))

    def taken(self) -> list[int]:
        return [] if self._begun is None else [view.t_robot_ns for view in self._begun[3].views]

    def catch_up(self) -> bool:
        if self._begun is None or self._metered == len(self._begun[3].views):
            return False
        target, camera, _, guide = self._begun
        if not isinstance(guide, Guide):
            return False
        self._metered = len(guide.views)
        self._meter = tuple(MeterReading(**asdict(reading)) for reading in read_meter(guide.views, target, camera))
        return False

    def _seen(self, t_robot_ns: int, view: BoardView | None, guidance: Guidance) -> BoardSeen:
        corners = () if view is None else tuple((float(u), float(v)) for u, v in view.corners_px.round(1))
        return BoardSeen(
            t_robot_ns=t_robot_ns,
            corners_px=corners,
            instruction=guidance.instruction,
            is_taken=guidance.is_taken,
            num_views=guidance.num_views,
            cells=guidance.cells,
            poses=guidance.poses,
            meter=self._meter,
            may_finish=guidance.may_finish,
            is_enough=guidance.is_enough,
        )

    def _require(self) -> tuple[Target, CameraCalibration, Finder, TargetGuide]:
        if self._begun is None:
            raise EstimationError("the board is not known yet; begin first")
        return self._begun


def _make_guide(kind: GuidedKind, target: Target, camera: CameraCalibration) -> TargetGuide:
    if kind == "wheels":
        return WheelsGuide(camera)
    return WavingGuide(target, camera) if kind == "camera-imu" else Guide(target, camera)
