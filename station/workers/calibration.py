"""What runs in the worker that watches a calibration board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from shared.calibration import CameraCalibration
from shared.errors import EstimationError
from station.calibration.boards import Finder, make_finder, view_board
from station.calibration.camera_imu.guide import WavingGuide
from station.calibration.guidance import GuidedKind, TargetGuide
from station.calibration.guide import Guide
from station.calibration.meter import read_meter
from station.calibration.target import Target
from station.calibration.target_page import page_target
from station.model.frames import ImageFrame
from station.workers.calibration_interface import BoardSeen, CalibrationProgram, MeterReading, PrintedBoard


class BoardWatcher(CalibrationProgram):
    """Follows one guided calibration. A camera's meter is read again while no picture waits."""

    def __init__(self, emit: Callable[[None], None]) -> None:  # noqa: ARG002
        self._begun: tuple[Target, CameraCalibration, Finder, TargetGuide] | None = None
        self._meter: tuple[MeterReading, ...] = ()
        self._metered = 0  # how many views the meter has seen

    def begin(self, kind: GuidedKind, board: Target | PrintedBoard, camera: CameraCalibration) -> Target:
        target = page_target(board.kind, board.size) if isinstance(board, PrintedBoard) else board
        guide = Guide(target, camera) if kind == "camera" else WavingGuide(target, camera)
        self._begun = (target, camera, make_finder(target), guide)
        return target

    def look(self, frame: ImageFrame) -> BoardSeen:
        target, _, finder, guide = self._require()
        view = view_board(finder, target, frame.grey(), frame.name, frame.t_robot_ns)
        guidance = guide.look(view)
        corners = () if view is None else tuple((float(u), float(v)) for u, v in view.corners_px.round(1))
        return BoardSeen(
            t_robot_ns=frame.t_robot_ns,
            corners_px=corners,
            instruction=guidance.instruction,
            is_taken=guidance.is_taken,
            num_views=guidance.num_views,
            cells=guidance.cells,
            poses=guidance.poses,
            meter=self._meter,
            is_enough=guidance.is_enough,
        )

    def taken(self) -> list[int]:
        return [view.t_robot_ns for view in self._require()[3].views]

    def catch_up(self) -> bool:
        if self._begun is None or self._metered == len(self._begun[3].views):
            return False
        target, camera, _, guide = self._begun
        if not isinstance(guide, Guide):
            return False
        self._metered = len(guide.views)
        self._meter = tuple(MeterReading(**asdict(reading)) for reading in read_meter(guide.views, target, camera))
        return False

    def _require(self) -> tuple[Target, CameraCalibration, Finder, TargetGuide]:
        if self._begun is None:
            raise EstimationError("the board is not known yet; begin first")
        return self._begun
