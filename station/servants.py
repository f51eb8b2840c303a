"""What runs inside the worker processes: SLAM of one navigation, localisation in one map, one heavy job."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shared.calibration import Calibration
from shared.errors import ConfigError, EstimationError
from station.frames import DriveSample, ImageFrame, ImuBatch
from station.maps.map import PlaceMap
from station.maps.store import MapStore
from station.navigation import Navigation, NavigationReport
from station.navigation_files import load_navigation, save_navigation
from station.sequencer import Sequencer
from station.slam.backend import SlamBackend
from station.workers import resolve

# Name in configuration and on the command line -> factory(calibration) -> SlamBackend, imported in the worker only.
BACKENDS = {
    "sfm": "station.slam.sfm.backend:SfmBackend",
    "ukf": "station.slam.ukf.backend:UkfBackend",
}
MAX_BAD_FRAMES = 30  # in a row: then the camera sends something that is no picture, and the person must know


def make_backend(name: str, calibration: Calibration) -> SlamBackend:
    """A backend by name, or by "package.module:factory". Raises ConfigError for a name that is not there."""
    path = name if ":" in name else BACKENDS.get(name, "")
    if not path:
        raise ConfigError(f"there is no SLAM backend {name!r}; choose one of {', '.join(BACKENDS)}")
    try:
        factory: Callable[[Calibration], SlamBackend] = resolve(path)
    except (ImportError, AttributeError) as exc:
        raise ConfigError(f"the SLAM backend {name!r} is not installed ({exc}); see `station doctor`") from exc
    return factory(calibration)


class SlamServant:
    """Follows one navigation; sends a SlamUpdate for every frame."""

    def __init__(self, emit: Callable[[Any], None]) -> None:
        self._emit = emit
        self._backend: SlamBackend | None = None
        self._sequencer = Sequencer(0.0, has_imu=False)
        self._started_s = 0.0
        self._failure = ""

    def begin(self, backend: str, calibration: Calibration) -> None:
        """Start a navigation."""
        camera = calibration.camera
        self._backend = make_backend(backend, calibration)
        shift_s = camera.time_shift_s if camera else 0.0
        self._sequencer = Sequencer(shift_s, has_imu=calibration.imu is not None)
        self._started_s = time.monotonic()

    def add_imu(self, t_robot_ns: list[int], gyro: list[Any], accel: list[Any]) -> None:
        times = np.array(t_robot_ns, dtype=np.int64)
        self._sequencer.add_imu(ImuBatch(times, np.array(gyro, dtype=np.float64), np.array(accel, dtype=np.float64)))
        self._advance()

    def add_drive(self, sample: DriveSample) -> None:
        self._sequencer.add_drive(sample)

    def add_frame(self, frame: ImageFrame) -> None:
        self._sequencer.add_frame(frame)
        self._advance()

    def finish(self, navigation_id: str, folder: Path) -> NavigationReport:
        """End the navigation and write it. Raises EstimationError with the reason when nothing came out."""
        for item in self._sequencer.rest():
            self._feed(item)
        if self._backend is None:
            raise EstimationError("the navigation ended before it began; record again")
        navigation = replace(self._backend.finish(), id=navigation_id)
        wall_s, cpu_s = time.monotonic() - self._started_s, time.process_time()
        factor = wall_s / navigation.report.duration_s if navigation.report.duration_s > 0 else 0.0
        report = replace(navigation.report, wall_s=wall_s, cpu_s=cpu_s, realtime_factor=factor)
        navigation = replace(navigation, report=report)
        save_navigation(navigation, folder)
        return navigation.report

    def _advance(self) -> None:
        for item in self._sequencer.ready():
            self._feed(item)

    def _feed(self, item: ImuBatch | DriveSample | ImageFrame) -> None:
        if self._backend is None:
            return
        if isinstance(item, ImuBatch):
            self._backend.add_imu(item)
        elif isinstance(item, DriveSample):
            self._backend.add_drive(item)
        else:
            self._emit(self._backend.add_frame(item))


@dataclass(frozen=True, slots=True, eq=False)
class BuiltMap:
    """What building left in the store."""

    map_id: str
    name: str
    places: int


class JobServant:
    """One heavy job; sends (fraction, sentence) as it goes."""

    def __init__(self, emit: Callable[[tuple[float, str]], None]) -> None:
        self._emit = emit

    def build_map(self, folders: list[Path], store: Path, name: str, mode: str | None) -> BuiltMap:
        """Navigation folders -> a map in the store."""
        from station.places.build import build_map  # heavy imports stay in the worker

        self._emit((0.05, "reading the navigation"))
        navigations = [load_navigation(folder) for folder in folders]
        self._emit((0.2, f"grouping {sum(len(n.landmarks) for n in navigations)} landmarks into places"))
        place_map: PlaceMap = build_map(_only(navigations), mode, name=name)  # type: ignore[arg-type]
        self._emit((0.8, f"saving {len(place_map.places)} places"))
        MapStore(store).save(place_map)
        return BuiltMap(place_map.id, place_map.name, len(place_map.places))


def _only(navigations: list[Navigation]) -> Navigation:
    if len(navigations) != 1:
        raise ConfigError(f"a map is built from one navigation, {len(navigations)} were given; name one")
    return navigations[0]
