"""What a SLAM worker can be asked. It follows one navigation and sends a SlamUpdate for every frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from shared.calibration import Calibration
from station.model.frames import DriveSample, ImageFrame
from station.model.navigation import NavigationReport
from station.model.slam_update import SlamUpdate
from station.workers.request import Limit, Program, ProgramName, Request

Vectors = Sequence[Sequence[float]]  # (N, 3); lists: the event loop makes no arrays


class SlamProgram(Program, ABC):
    """Follows one navigation with a backend."""

    @abstractmethod
    def begin(self, backend: str, calibration: Calibration, seed: int) -> None: ...

    @abstractmethod
    def add_imu(self, t_robot_ns: Sequence[int], gyro: Vectors, accel: Vectors) -> None: ...

    @abstractmethod
    def add_drive(self, sample: DriveSample) -> None: ...

    @abstractmethod
    def add_frame(self, frame: ImageFrame) -> None: ...

    @abstractmethod
    def finish(self, navigation_id: str, folder: Path) -> NavigationReport: ...


SLAM: ProgramName[SlamProgram, SlamUpdate] = ProgramName("station.workers.slam", "NavigationSlam")


@dataclass(frozen=True, slots=True)
class BeginNavigation(Request[SlamProgram, None]):
    """The first request of all. The backend is given by name, or by "package.module:factory"."""

    backend: str
    calibration: Calibration
    seed: int

    def run(self, program: SlamProgram) -> None:
        program.begin(self.backend, self.calibration, self.seed)


@dataclass(frozen=True, slots=True)
class AddImu(Request[SlamProgram, None]):
    """Inertial samples in time order: rad/s, m/s^2."""

    t_robot_ns: Sequence[int]
    gyro_imu: Vectors
    accel_imu: Vectors

    def run(self, program: SlamProgram) -> None:
        program.add_imu(self.t_robot_ns, self.gyro_imu, self.accel_imu)


@dataclass(frozen=True, slots=True)
class AddDrive(Request[SlamProgram, None]):
    """A velocity the motors were told to hold."""

    limit: ClassVar[Limit] = Limit(6000)  # 20 a second: five minutes
    sample: DriveSample

    def run(self, program: SlamProgram) -> None:
        program.add_drive(self.sample)


@dataclass(frozen=True, slots=True)
class AddFrame(Request[SlamProgram, None]):
    """A camera image."""

    frame: ImageFrame

    def run(self, program: SlamProgram) -> None:
        program.add_frame(self.frame)


@dataclass(frozen=True, slots=True)
class FinishNavigation(Request[SlamProgram, NavigationReport]):
    """End the navigation and write it. EstimationError with the reason when nothing came out."""

    navigation_id: str
    folder: Path

    def run(self, program: SlamProgram) -> NavigationReport:
        return program.finish(self.navigation_id, self.folder)
