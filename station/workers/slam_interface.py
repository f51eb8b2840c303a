"""What a SLAM worker can be asked. It follows one navigation and sends a SlamUpdate for every frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

from shared.calibration import Calibration
from station.model.frames import DepthFrame, DriveSample, ImageFrame
from station.model.navigation import NavigationReport
from station.model.slam_update import SlamUpdate
from station.workers.request import Program, ProgramName, Vectors


class SlamProgram(Program, ABC):
    """Follows one navigation with a backend."""

    @abstractmethod
    def begin(self, backend: str, calibration: Calibration, seed: int) -> None:
        """The first request of all. The backend is given by name, or by "package.module:factory"."""

    @abstractmethod
    def add_imu(self, t_robot_ns: Sequence[int], gyro: Vectors, accel: Vectors) -> None:
        """Inertial samples in time order: rad/s, m/s^2."""

    @abstractmethod
    def add_drive(self, sample: DriveSample) -> None:
        """A velocity the motors were told to hold."""

    @abstractmethod
    def add_depth(self, frame: DepthFrame) -> None:
        """What a depth sensor measured, in its own time order. It is used when the navigation ends."""

    @abstractmethod
    def add_frame(self, frame: ImageFrame) -> None: ...

    @abstractmethod
    def finish(self, navigation_id: str, folder: Path) -> NavigationReport:
        """End the navigation and write it. Raises EstimationError with the reason when nothing came out."""


SLAM: ProgramName[SlamProgram, SlamUpdate] = ProgramName("station.workers.slam", "NavigationSlam")
