"""What the worker that watches a calibration board can be asked; it sends what it saw of each picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

from shared.calibration import CameraCalibration
from station.calibration.guidance import GuidedKind
from station.calibration.target import Target, TargetKind
from station.model.frames import DriveSample, ImageFrame
from station.workers.request import Program, ProgramName

# In the folder of a session:
RECORDING, RESULT, RESIDUALS = "recording.mcap", "result.json", "residuals.png"
Xyz = tuple[float, float, float]
PaperSize = Literal["A4", "A3", "Letter"]


@dataclass(frozen=True, slots=True)
class MeterReading:
    """One quantity, and how well the views so far tell it."""

    name: str
    value: float
    sigma: float
    wanted: float
    unit: str


@dataclass(frozen=True, slots=True)
class BoardSeen:
    """What one picture shows of the board, and what to do next; or a second of an IMU, by itself."""

    t_robot_ns: int
    corners_px: tuple[tuple[float, float], ...]
    instruction: str
    is_taken: bool  # this view counts
    num_views: int
    cells: tuple[float, ...]  # how full each of the 3x3 cells of the picture is, 0..1, by rows; none where all will do
    poses: dict[str, float]
    meter: tuple[MeterReading, ...]
    may_finish: bool
    is_enough: bool


@dataclass(frozen=True, slots=True)
class PrintedBoard:
    """A board that fills a page of paper, as this station prints it."""

    kind: TargetKind
    size: PaperSize
    ruler_mm: float = 100.0  # what the page's ruler, meant to be 100 mm long, measures: printers scale


class CalibrationProgram(Program, ABC):
    """Looks for the board in pictures and chooses those that count; or feels how an IMU lies or is carried."""

    @abstractmethod
    def begin(self, kind: GuidedKind, board: Target | PrintedBoard, camera: CameraCalibration) -> Target:
        """The first request where a board is shown; returns it with its numbers. `camera` as the robot tells it."""

    @abstractmethod
    def begin_without_board(self, kind: GuidedKind) -> None:
        """The first request where there is none: how an inertial unit lies still, or is carried about."""

    @abstractmethod
    def look(self, frame: ImageFrame) -> BoardSeen:
        """What this picture shows. Raises DataError for one that cannot be decoded."""

    @abstractmethod
    def drive(self, samples: list[DriveSample]) -> None:
        """What the motors were told since the last call."""

    @abstractmethod
    def feel(self, t_robot_ns: list[int], gyro_imu: list[Xyz], accel_imu: list[Xyz]) -> BoardSeen:
        """What a second of inertial samples says of its rest, or of how it is carried about."""

    @abstractmethod
    def taken(self) -> list[int]:
        """The times (robot clock, ns) of the pictures that count."""


WATCHER: ProgramName[CalibrationProgram, None] = ProgramName("station.workers.calibration", "BoardWatcher")
