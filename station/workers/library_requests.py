"""What the worker of a job can be asked: maps, comparisons and navigations made of what lies on disk."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.model.map_store import StoreAddress
from station.model.navigation import NavigationReport
from station.places.making.config import PlacesMode
from station.workers.request import Program, ProgramName, Request


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
        self, folders: list[Path], address: StoreAddress, name: str, mode: PlacesMode | None, executor: str = ""
    ) -> BuiltMap: ...

    @abstractmethod
    def index_map(self, folders: list[Path], address: StoreAddress) -> None: ...

    @abstractmethod
    def measure_places(self, address: StoreAddress, map_id: str) -> dict[str, float]: ...

    @abstractmethod
    def compare(self, first: Path, second: Path, out: Path, title: str, setting: str) -> dict[str, Any]: ...

    @abstractmethod
    def reprocess(
        self, recording: Path, backend: str, seed: int, navigation_id: str, folder: Path, executor: str = ""
    ) -> NavigationReport: ...


LIBRARY: ProgramName[LibraryProgram, Progress] = ProgramName("station.workers.library_jobs", "LibraryJobs")


@dataclass(frozen=True, slots=True)
class BuildMap(Request[LibraryProgram, BuiltMap]):
    """Navigation folders -> a map in the store. Places of an earlier map of the first one stay."""

    folders: list[Path]
    address: StoreAddress
    name: str
    mode: PlacesMode | None
    executor: str

    def run(self, program: LibraryProgram) -> BuiltMap:
        return program.build_map(self.folders, self.address, self.name, self.mode, self.executor)


@dataclass(frozen=True, slots=True)
class IndexMap(Request[LibraryProgram, None]):
    """The localisation index of the map that this worker built from these folders, where it costs little."""

    folders: list[Path]
    address: StoreAddress

    def run(self, program: LibraryProgram) -> None:
        program.index_map(self.folders, self.address)


@dataclass(frozen=True, slots=True)
class MeasurePlaces(Request[LibraryProgram, dict[str, float]]):
    """The repeatability of each place of a map, by its id."""

    address: StoreAddress
    map_id: str

    def run(self, program: LibraryProgram) -> dict[str, float]:
        return program.measure_places(self.address, self.map_id)


@dataclass(frozen=True, slots=True)
class CompareNavigations(Request[LibraryProgram, dict[str, Any]]):
    """Two navigation folders -> the experiment's report in `out`, which says `setting`; answers its results.json."""

    first: Path
    second: Path
    out: Path
    title: str
    setting: str

    def run(self, program: LibraryProgram) -> dict[str, Any]:
        return program.compare(self.first, self.second, self.out, self.title, self.setting)


@dataclass(frozen=True, slots=True)
class Reprocess(Request[LibraryProgram, NavigationReport]):
    """A recording -> its navigation folder, by running SLAM over it again."""

    recording: Path
    backend: str
    seed: int
    navigation_id: str
    folder: Path
    executor: str

    def run(self, program: LibraryProgram) -> NavigationReport:
        return program.reprocess(
            self.recording, self.backend, self.seed, self.navigation_id, self.folder, self.executor
        )
