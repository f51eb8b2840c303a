"""What a localisation worker can be asked: the place of pictures, in the maps that it was given."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from shared.calibration import Calibration
from shared.geometry import FloatArray
from station.model.calibration_fit import CalibrationFit
from station.model.frames import DriveSample, ImageFrame
from station.model.map_store import StoreAddress
from station.model.place_answer import HijackNotice, MapLeftOut, MapReading, PlaceReport
from station.model.place_map import Grouping
from station.workers.request import Program, ProgramName, Vectors

PlaceEvent = HijackNotice | MapReading | MapLeftOut


class PlaceProgram(Program, ABC):
    """Says of pictures at which place of its maps they were taken."""

    @abstractmethod
    def load(self, store: StoreAddress, map_ids: tuple[str, ...]) -> None:
        """Read maps and prepare to look in them. Raises DataError when none of them can be read."""

    @abstractmethod
    def calibrate(self, calibration: Calibration) -> None:
        """The robot that drives now; what was known of another one's position is forgotten."""

    @abstractmethod
    def regroup(self, grouping: Grouping) -> None:
        """A map's places or rooms are others, or have other names; what is known of the robot's pose stays."""

    @abstractmethod
    def add_imu(self, t_robot_ns: Sequence[int], gyro: Vectors, accel: Vectors) -> None:
        """Inertial samples in time order (rad/s, m/s^2): they notice a hijack and carry the estimate."""

    @abstractmethod
    def add_drive(self, sample: DriveSample) -> None:
        """A velocity the motors were told to hold."""

    @abstractmethod
    def add_pose(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int) -> None:
        """A pose of the running navigation: carries the estimate between pictures."""

    @abstractmethod
    def use_fit(self, fit: CalibrationFit | None) -> None:
        """Whether the calibration explains what this robot measures, as far as its SLAM knows."""

    @abstractmethod
    def answer(self, frame: ImageFrame) -> PlaceReport:
        """Where this picture was taken, and the current place at its time."""


PLACES: ProgramName[PlaceProgram, PlaceEvent] = ProgramName("station.workers.places", "PlaceFinder")
