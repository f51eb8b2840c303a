"""What the worker of a job can be asked: maps, comparisons and navigations made of what lies on disk."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shared.calibration import CameraCalibration
from station.calibration.target import Target, TargetKind
from station.model.map_store import StoreAddress
from station.model.navigation import NavigationReport
from station.model.place_map import PlaceGrain
from station.places.making.config import PlacesMode
from station.workers.calibration_interface import PaperSize
from station.workers.request import Program, ProgramName


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is: the event that its worker sends."""

    fraction: float  # 0..1
    message: str


@dataclass(frozen=True, slots=True)
class BuiltMap:
    """What building left in the store."""

    map_id: str
    name: str
    places: int


class LibraryProgram(Program, ABC):
    """Does one job, in one or several requests."""

    @abstractmethod
    def build_map(
        self,
        folders: list[Path],
        address: StoreAddress,
        name: str,
        mode: PlacesMode | None,
        executor: str = "",
        places: PlaceGrain = "rooms",
    ) -> BuiltMap:
        """Navigation folders -> a map in the store. Places of an earlier map of the first one stay."""

    @abstractmethod
    def prepare_index(self, folders: list[Path]) -> None:
        """Begin with the localisation index of the map that another worker builds meanwhile, where it costs little."""

    @abstractmethod
    def index_map(self, folders: list[Path], address: StoreAddress, map_id: str) -> None:
        """The localisation index of the map that was built from these folders, where it costs little."""

    @abstractmethod
    def read_plates(self, address: StoreAddress, map_id: str) -> bool:
        """Suggest names for a map's rooms by printed words in its pictures; whether the map has others now.

        Takes a multiple of the time of all before it, so nobody should wait for it. Raises DataError: the map is
        another one by now.
        """

    @abstractmethod
    def measure_places(self, address: StoreAddress, map_id: str) -> dict[str, float]:
        """The repeatability of each place of a map, by its id."""

    @abstractmethod
    def compare(self, first: Path, second: Path, out: Path, title: str, setting: str) -> dict[str, Any]:
        """Two navigation folders -> the experiment's report in `out`, which says `setting`; returns results.json."""

    @abstractmethod
    def reprocess(
        self, recording: Path, backend: str, seed: int, navigation_id: str, folder: Path, executor: str = ""
    ) -> NavigationReport:
        """A recording -> its navigation folder, by running SLAM over it again."""

    @abstractmethod
    def calibrate_camera(
        self, folder: Path, times_ns: list[int], target: Target, told: CameraCalibration
    ) -> dict[str, Any]:
        """The camera, from these pictures of the folder's recording; result and plot are written there."""

    @abstractmethod
    def calibrate_camera_imu(self, folder: Path, target: Target, told: CameraCalibration) -> dict[str, Any]:
        """How camera and IMU sit on each other, from the folder's recording; result and plot are written there."""

    @abstractmethod
    def calibrate_wheels(self, folder: Path, target: Target) -> dict[str, Any]:
        """What the wheels make of a command, from the folder's recording; result and plot are written there."""

    @abstractmethod
    def calibrate_imu(self, folder: Path) -> dict[str, Any]:
        """The IMU's noise, from the folder's recording; result and plot are written there."""

    @abstractmethod
    def check_calibration(self, folder: Path) -> dict[str, Any]:
        """Whether what the robot tells fits the folder's recording; the result, repaired, is written there."""

    @abstractmethod
    def target_page(self, kind: TargetKind, size: PaperSize) -> bytes:
        """A target to print that fills a page, as PDF."""


LIBRARY: ProgramName[LibraryProgram, Progress] = ProgramName("station.workers.library_jobs", "LibraryJobs")
