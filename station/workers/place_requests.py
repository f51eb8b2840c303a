"""What a localisation worker can be asked: the place of pictures, in the maps that it was given."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from shared.calibration import Calibration
from shared.geometry import FloatArray
from station.model.frames import DriveSample, ImageFrame
from station.model.map_store import StoreAddress
from station.model.place_answer import HijackNotice, MapLeftOut, MapReading, PlaceReport
from station.model.place_map import Place, PlaceEdge
from station.workers.request import Limit, Program, ProgramName, Request

Vectors = Sequence[Sequence[float]]  # (N, 3); lists: the event loop makes no arrays
PlaceEvent = HijackNotice | MapReading | MapLeftOut


class PlaceProgram(Program, ABC):
    """Says of pictures at which place of its maps they were taken."""

    @abstractmethod
    def load(self, store: StoreAddress, map_ids: tuple[str, ...]) -> None: ...

    @abstractmethod
    def calibrate(self, calibration: Calibration) -> None: ...

    @abstractmethod
    def regroup(self, map_id: str, places: tuple[Place, ...], edges: tuple[PlaceEdge, ...]) -> None: ...

    @abstractmethod
    def add_imu(self, t_robot_ns: Sequence[int], gyro: Vectors, accel: Vectors) -> None: ...

    @abstractmethod
    def add_drive(self, sample: DriveSample) -> None: ...

    @abstractmethod
    def add_pose(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int) -> None: ...

    @abstractmethod
    def answer(self, frame: ImageFrame) -> PlaceReport: ...


PLACES: ProgramName[PlaceProgram, PlaceEvent] = ProgramName("station.workers.places", "PlaceFinder")


@dataclass(frozen=True, slots=True)
class LoadMaps(Request[PlaceProgram, None]):
    """Read maps and prepare to look in them. DataError when none of them can be read."""

    store: StoreAddress
    map_ids: tuple[str, ...]

    def run(self, program: PlaceProgram) -> None:
        program.load(self.store, self.map_ids)


@dataclass(frozen=True, slots=True)
class UseCalibration(Request[PlaceProgram, None]):
    """The robot that drives now; what was known of another one's position is forgotten."""

    calibration: Calibration

    def run(self, program: PlaceProgram) -> None:
        program.calibrate(self.calibration)


@dataclass(frozen=True, slots=True)
class RegroupPlaces(Request[PlaceProgram, None]):
    """A map's places are others, or have other names; what is known of the robot's pose stays."""

    map_id: str
    places: tuple[Place, ...]
    edges: tuple[PlaceEdge, ...]

    def run(self, program: PlaceProgram) -> None:
        program.regroup(self.map_id, self.places, self.edges)


@dataclass(frozen=True, slots=True)
class AddImu(Request[PlaceProgram, None]):
    """Inertial samples in time order (rad/s, m/s^2): they notice a hijack and carry the estimate."""

    limit: ClassVar[Limit] = Limit(30_000)  # batches: two minutes if each is one sample
    t_robot_ns: Sequence[int]
    gyro_imu: Vectors
    accel_imu: Vectors

    def run(self, program: PlaceProgram) -> None:
        program.add_imu(self.t_robot_ns, self.gyro_imu, self.accel_imu)


@dataclass(frozen=True, slots=True)
class AddDrive(Request[PlaceProgram, None]):
    """A velocity the motors were told to hold."""

    limit: ClassVar[Limit] = Limit(2400)  # two minutes
    sample: DriveSample

    def run(self, program: PlaceProgram) -> None:
        program.add_drive(self.sample)


@dataclass(frozen=True, slots=True, eq=False)
class AddPose(Request[PlaceProgram, None]):
    """A pose of the running navigation: carries the estimate between pictures."""

    limit: ClassVar[Limit] = Limit(300)
    t_robot_ns: int
    T_nav_body: FloatArray  # (4, 4)
    segment: int

    def run(self, program: PlaceProgram) -> None:
        program.add_pose(self.t_robot_ns, self.T_nav_body, self.segment)


@dataclass(frozen=True, slots=True)
class LocatePicture(Request[PlaceProgram, PlaceReport]):
    """Where this picture was taken, and the current place at its time."""

    frame: ImageFrame

    def run(self, program: PlaceProgram) -> PlaceReport:
        return program.answer(self.frame)
