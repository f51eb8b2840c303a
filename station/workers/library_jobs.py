"""What runs in the worker of a job."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from shared.calibration import CameraCalibration
from shared.errors import DataError
from station.calibration.camera_imu.guided import estimate_camera_imu
from station.calibration.guided import estimate_camera, store_result
from station.calibration.imu.guided import estimate_imu
from station.calibration.target import Target, TargetKind
from station.calibration.targetless.guided import estimate_check
from station.calibration.wheels_guided import estimate_wheels
from station.datasets import open_dataset
from station.files.navigation_folder import PICTURES, load_navigation, save_navigation
from station.files.unwritable import cannot_write, why_unwritable
from station.maps.repair.purging import tidy_up
from station.maps.store import MapStore
from station.model.floor_plan import NameSuggestion
from station.model.map_store import StoreAddress
from station.model.navigation import Navigation, NavigationReport
from station.model.place_map import PlaceGrain, PlaceMap
from station.model.slam_update import SlamUpdate
from station.places.joining.growing import keep_places
from station.places.joining.known_names import names_in
from station.places.joining.merge import merge_navigations
from station.places.localisation.described_pictures import DescribedPictures
from station.places.localisation.index_file import PreparedIndex, index_of
from station.places.making.build import build_map
from station.places.making.config import PlacesConfig, PlacesMode
from station.places.making.repeatability import repeatability
from station.places.naming.suggest import plate_names, sticker_names
from station.places.rooms.planning import planned, with_plan, with_suggestions_of
from station.slam.backends import make_backend
from station.slam.run import run_backend
from station.vision.printed import can_read_print
from station.workers.calibration_interface import RECORDING, RESIDUALS, RESULT, PaperSize
from station.workers.executors.opening import open_executor
from station.workers.library_interface import BuiltMap, LibraryProgram, Progress
from station.workers.mapping import MapOfNavigations, Reconstruction, Recorded, make_map, reconstruct_all
from station.workers.repeatable import repeatable

MAX_OTHER_MAPS = 3  # that a new one is compared with: its home's is mostly the one changed last; each takes seconds


class LibraryJobs(LibraryProgram):
    """One job; sends how far it is."""

    def __init__(self, emit: Callable[[Progress], None]) -> None:
        self._emit = emit
        self._prepared: PreparedIndex | None = None

    def build_map(
        self,
        folders: list[Path],
        address: StoreAddress,
        name: str,
        mode: PlacesMode | None,
        executor: str = "",
        places: PlaceGrain = "rooms",
    ) -> BuiltMap:
        store = MapStore(address)
        store.require_writable()  # before the work
        self._emit(Progress(0.05, "reading the navigation"))
        navigations = [load_navigation(folder) for folder in folders]
        config = PlacesConfig() if mode is None else PlacesConfig(mode=mode)
        if len(navigations) > 1:
            self._emit(Progress(0.1, f"registering {_count(len(navigations) - 1, 'navigation')} to the first one"))
        place_map = self._map_of(navigations, config, name, executor).with_grain(places)
        self._emit(Progress(0.7, "finding rooms and doors"))
        first = navigations[0].id
        earlier = store.newest_of_navigation(first)
        draft = _taking_over(place_map, earlier)
        self._emit(Progress(0.75, "looking for stickers that name rooms"))
        found = () if draft.plan is None else sticker_names(draft, draft.plan)
        found += self._names_elsewhere(store, draft, config)
        if earlier is not None and _of_same_pictures(earlier, place_map):  # they are read again later
            found += _plates_of(earlier)
        place_map = replace(place_map, suggestions=found)
        self._emit(Progress(0.8, f"saving {_count(len(draft.places), 'place')}"))

        def taking_over(built: PlaceMap, newest: PlaceMap | None) -> PlaceMap:
            """That took long: what people did to places and rooms meanwhile is taken over, too."""
            if newest is None and earlier is None and draft.plan is not None:
                return with_plan(replace(draft, plan=None, suggestions=built.suggestions), draft.plan)
            return _taking_over(built, newest)

        place_map = store.rebuild(place_map, first, taking_over, f"built from {place_map.navigation.id}"[:200])
        with contextlib.suppress(DataError):  # the map is there
            tidy_up(store)
        return BuiltMap(place_map.id, place_map.name, len(place_map.places))

    def _names_elsewhere(self, store: MapStore, draft: PlaceMap, config: PlacesConfig) -> tuple[NameSuggestion, ...]:
        """What people called the same rooms in a map of another drive: the latest that knows any."""
        if config.mode == "thesis" or draft.plan is None:
            return ()
        own = set(draft.navigation.id.split("+"))
        named = [
            record.map_id
            for record in store.records()
            if record.plan is not None and record.plan.edits.names and own.isdisjoint(record.navigation.split("+"))
        ]
        for map_id in named[:MAX_OTHER_MAPS]:
            try:
                other = store.load(map_id)
            except DataError:
                continue  # it is told of where maps are listed
            self._emit(Progress(0.78, f"looking whether {other.name} is of the same rooms"))
            if found := names_in(other, draft, config):
                return found
        return ()

    def prepare_index(self, folders: list[Path]) -> None:
        if len(folders) > 1:  # how they lie in each other's frames is not known yet
            return
        with contextlib.suppress(DataError), repeatable(1):  # who builds the map says so, and has the other core
            navigation = load_navigation(folders[0])
            pictures = _described(folders, navigation)
            self._prepared = None if pictures is None else PreparedIndex.of(navigation, pictures)

    def index_map(self, folders: list[Path], address: StoreAddress, map_id: str) -> None:
        """Where most pictures were described while the robot drove.

        Else that is left to localisation: it can take minutes, and the map can be seen meanwhile.
        """
        place_map = MapStore(address).load(map_id)
        pictures = _described(folders, place_map.navigation)
        if pictures is not None:
            self._emit(Progress(0.85, "indexing what its pictures look like"))
            waiting = Progress(0.85, "another map is indexed; this one is next")
            index_of(address.root, place_map, lambda: None, lambda: self._emit(waiting), pictures, self._prepared)

    def read_plates(self, address: StoreAddress, map_id: str) -> bool:
        store = MapStore(address)
        place_map = store.load(map_id)
        if place_map.plan is None or not can_read_print():
            return False
        found = plate_names(place_map, place_map.plan, lambda text: self._emit(Progress(0.95, text)))
        if not found:  # a reader that failed finds none either: what was read of these pictures before stays
            return False

        def with_plates(now: PlaceMap) -> PlaceMap:
            """The map as it is by now: people may have changed it meanwhile."""
            if not _of_same_pictures(now, place_map):
                raise DataError(f"{place_map.name} was made anew meanwhile")
            return with_suggestions_of(now, "door plate", found)

        store.edit(map_id, with_plates, "names on door plates were read")
        return True

    def measure_places(self, address: StoreAddress, map_id: str) -> dict[str, float]:
        self._emit(Progress(0.1, "reading the map"))
        place_map = MapStore(address).load(map_id)
        self._emit(Progress(0.3, f"grouping {_count(len(place_map.navigation.landmarks), 'landmark')} anew"))
        shares = repeatability(place_map).tolist()
        return {place.id: share for place, share in zip(place_map.places, shares, strict=True)}

    def _map_of(self, navigations: list[Navigation], config: PlacesConfig, name: str, executor: str) -> PlaceMap:
        if executor:
            with open_executor(executor) as machines:
                return machines.map(make_map, [MapOfNavigations(tuple(navigations), config, name)])[0]
        navigation = merge_navigations(navigations, config)
        self._emit(Progress(0.5, f"grouping {_count(len(navigation.landmarks), 'landmark')} into places"))
        return build_map(navigation, config=config, name=name)

    def compare(self, first: Path, second: Path, out: Path, title: str, setting: str) -> dict[str, Any]:
        # Drawing loads matplotlib, which no other job needs.
        from station.experiments.experiment import Story, results_dict, run_experiment
        from station.experiments.report import write_experiment

        self._emit(Progress(0.05, "reading two navigations"))
        navigations = load_navigation(first), load_navigation(second)
        steps = iter((0.15, 0.35))
        done = run_experiment(
            *navigations,
            PlacesConfig(),
            story=Story(title=title, setting=(setting,)),
            say=lambda text: self._emit(Progress(next(steps, 0.6), text)),
        )
        self._emit(Progress(0.7, "drawing the report"))
        write_experiment(done, out)
        return results_dict(done)

    def calibrate_camera(
        self, folder: Path, times_ns: list[int], target: Target, told: CameraCalibration
    ) -> dict[str, Any]:
        result = estimate_camera(folder / RECORDING, times_ns, target, told, folder / RESIDUALS, self._progress)
        store_result(result, folder / RESULT)
        return result

    def calibrate_camera_imu(self, folder: Path, target: Target, told: CameraCalibration) -> dict[str, Any]:
        result = estimate_camera_imu(folder / RECORDING, target, told, folder / RESIDUALS, self._progress)
        store_result(result, folder / RESULT)
        return result

    def calibrate_wheels(self, folder: Path, target: Target) -> dict[str, Any]:
        result = estimate_wheels(folder / RECORDING, target, folder / RESIDUALS, self._progress)
        store_result(result, folder / RESULT)
        return result

    def calibrate_imu(self, folder: Path) -> dict[str, Any]:
        result = estimate_imu(folder / RECORDING, folder / RESIDUALS, self._progress)
        store_result(result, folder / RESULT)
        return result

    def check_calibration(self, folder: Path) -> dict[str, Any]:
        result = estimate_check(folder / RECORDING, self._progress)
        store_result(result, folder / RESULT)
        return result

    def _progress(self, share: float, text: str) -> None:
        self._emit(Progress(share, text))

    def target_page(self, kind: TargetKind, size: PaperSize) -> bytes:
        return _pdf(kind, size)

    def reprocess(
        self, recording: Path, backend: str, seed: int, navigation_id: str, folder: Path, executor: str = ""
    ) -> NavigationReport:
        if (reason := why_unwritable(folder.parent)) is not None:  # before the work
            raise cannot_write(folder, reason)
        if executor:
            self._emit(Progress(0.02, f"SLAM runs at {executor}"))
            with open_executor(executor) as machines:
                piece = Reconstruction(Recorded(recording), backend, seed, navigation_id)
                [navigation] = reconstruct_all(machines, [piece])
            save_navigation(navigation, folder)
            return navigation.report
        self._emit(Progress(0.02, "reading the recording"))
        data = open_dataset(recording)
        if not data.has_images:
            raise DataError("the recording has no pictures; SLAM needs them")
        slam = make_backend(backend, data.calibration, seed)
        total = max(len(data.frame_times_ns), 1)
        seen = 0

        def count(update: SlamUpdate) -> None:
            nonlocal seen
            seen += 1
            if seen % 10 == 1:
                self._emit(Progress(0.05 + 0.6 * seen / total, f"picture {seen} of {total}: {update.message}"))

        def finishing() -> None:
            self._emit(Progress(0.65, "computing trajectory and landmarks"))

        navigation = replace(run_backend(slam, data.events(), count, finishing), id=navigation_id)
        self._emit(Progress(0.95, f"saving {_count(len(navigation.landmarks), 'landmark')}"))
        save_navigation(navigation, folder)
        return navigation.report


def _described(folders: list[Path], navigation: Navigation) -> DescribedPictures | None:
    """What was found in the navigation's pictures while the robot drove; None where that is less than half of them."""
    pictures = DescribedPictures(navigation.calibration.up_in_image_deg)
    for folder in folders:
        pictures.add(folder / PICTURES)
    encoded = navigation.keyframes.encoded
    return pictures if 2 * sum(pictures.knows(picture) for picture in encoded) > len(encoded) else None


def _of_same_pictures(one: PlaceMap, other: PlaceMap) -> bool:
    return one.id == other.id and one.navigation.keyframes.encoded == other.navigation.keyframes.encoded


def _plates_of(place_map: PlaceMap) -> tuple[NameSuggestion, ...]:
    return tuple(s for s in place_map.suggestions if s.source == "door plate")


def _taking_over(built: PlaceMap, earlier: PlaceMap | None) -> PlaceMap:
    """The map with its plan, and with the places, names and edits of the one before."""
    return planned(built if earlier is None else keep_places(earlier, built), earlier)


def _pdf(kind: TargetKind, size: PaperSize) -> bytes:
    # Drawing loads matplotlib.
    from station.calibration.target_page import page_target, write_page

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "target.pdf"
        write_page(page_target(kind, size), size, path)
        return path.read_bytes()


def _count(number: int, word: str) -> str:
    return f"{number} {word}" + ("" if number == 1 else "s")
