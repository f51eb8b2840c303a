"""The running station, wired: sessions of robots, and the maps, navigations and jobs they share. Start reading here.

One object with plain methods; the API is a thin layer over it, and so is a test. Nothing here computes: frames go to
worker processes, files to threads, and the event loop only carries messages.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from shared.bounded import shown
from shared.disk import remove_scratch
from shared.errors import DataError, RobotSystemError
from shared.geometry import FloatArray
from station.access.visitors import open_access
from station.calibration.guidance import GuidedKind
from station.calibration.target import TargetKind
from station.config import RecordingConfig, StationConfig
from station.errors import Conflict, Unknown
from station.events import EventKind, Events, EventsOfAll
from station.library.bin import Bin, Kind
from station.library.comparisons import Comparisons, summarise
from station.library.maps import Maps
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.library.navigations import Navigations
from station.library.place_changes import PlacesChange, PlacesEdit
from station.library.recordings import follow_elsewhere, recover_recordings, retain_recordings
from station.model.map_store import MapSummary, StoreAddress
from station.model.place_map import PlaceGrain
from station.places.making.config import PlacesMode
from station.recordings.recorder import Recorder
from station.robots.guided_calibration import CalibrationSession
from station.robots.navigation_files import NavigationRecorder
from station.robots.session import RobotSession, Shared
from station.workers.calibration_interface import PaperSize
from station.workers.jobs import Job, Jobs, JobWorker
from station.workers.library_interface import LIBRARY, LibraryProgram
from station.workers.place_interface import PLACES, PlaceEvent, PlaceProgram
from station.workers.request import ProgramName
from station.workers.scheduling import ComputeSlots
from station.workers.worker import Worker, warm_up

logger = logging.getLogger(__name__)
STATES: tuple[EventKind, ...] = ("robot", "driver", "pose", "landmarks", "map", "place", "bin", "calibration")
BIN_CHECK_S = 3600.0
ESTIMATED: dict[GuidedKind, str] = {
    "camera": "camera",
    "camera-imu": "camera and IMU",
    "wheels": "wheels",
    "imu": "IMU",
    "check": "calibration's fit",
}
SESSION_RESTART_S = 1.0


class Station:
    """What all robots share, a session for each, and what a person can ask of it."""

    def __init__(
        self,
        config: StationConfig,
        make_recorder: Callable[[Path], NavigationRecorder | None] | None = None,
        place_program: ProgramName[PlaceProgram, PlaceEvent] = PLACES,
    ) -> None:
        """`place_program` is what the localisation workers run.

        Raises ConfigError: others than this machine would reach it, and it is not set up who may.
        """
        self.config = config
        self.started_s = time.monotonic()
        self.events = EventsOfAll()
        self.access = open_access(config)
        self.jobs = Jobs(self.events, LIBRARY)
        store = StoreAddress(config.data_dir / "maps", config.store.database, config.store.blobs, config.name)
        self.maps = Maps(store, self.events)
        self.comparisons = Comparisons(config.data_dir / "comparisons")
        self.bin = Bin(config.data_dir / "bin.json")
        self.navigations = Navigations(NavigationLibrary(config.data_dir / "navigations"), self.events)
        shared = Shared(
            config,
            store,
            self.maps.active,
            self.navigations,
            self.access.robots,
            make_recorder or (lambda path: open_recorder(path, config.recordings)),
            place_program,
            ComputeSlots(),
        )
        self._pages: dict[tuple[TargetKind, PaperSize], bytes] = {}  # calibration targets, as PDF
        self._drawing = asyncio.Lock()  # one of them
        self.robots: dict[str, RobotSession] = {}
        for robot in config.fleet:
            events = Events()
            self.events.robots.append(events)
            path = f"/robots/{robot.name}" if self.robots else ""
            self.robots[robot.name] = RobotSession(robot, events, shared, path)

    async def run(self, started: Callable[[], Any] = lambda: None) -> None:
        """Run until cancelled. The link ends first, and with it the motors; then navigations are closed."""
        await asyncio.to_thread(warm_up)
        interrupted = self.navigations.library.open()
        for navigation in interrupted:
            self.events.notify("navigation", f"{navigation.name} was interrupted; its recording is kept", "warning")
        if self.navigations.library.unwritable:
            text = f"{self.navigations.library.unwritable}; until then nothing can be recorded or changed"
            self.events.notify("navigation", text, "error")
            logger.error("%s", text)
        await self.maps.open()
        self.bin.open()
        await asyncio.to_thread(self.comparisons.clean)
        await self._tidy_bin()
        await self._look_in_active_maps()
        for kind in STATES:
            self.events.changed(kind)  # who listens from now on is first told how everything is
        try:
            async with asyncio.TaskGroup() as tasks:
                for robot in self.robots.values():
                    tasks.create_task(self._keep_running(robot), name=f"robot {robot.name}")
                tasks.create_task(self._every_hour(), name="bin")
                tasks.create_task(self._tidy_up(interrupted), name="recordings")
                tasks.create_task(follow_elsewhere(self.navigations, self.events), name="navigations of other stations")
                tasks.create_task(self.access.door.watch(), name="door")
                started()
        finally:
            closing = [*(robot.close() for robot in self.robots.values()), self.jobs.close()]
            failed = [e for e in await asyncio.gather(*closing, return_exceptions=True) if isinstance(e, Exception)]
            await self.navigations.close()
            if failed:  # told only now: one that fails must not keep the others open
                raise failed[0]

    async def _keep_running(self, robot: RobotSession) -> None:
        """A bug that shows with one robot must not stop the others: its link and drive timer are started again."""
        while True:
            try:
                await robot.run()
            except Exception as exc:  # on top of the robot's tasks: its motors are stopped, its link is closed
                logger.exception("robot %s", robot.name)
                text = f"an error of the station stopped what runs for this robot: {_first_cause(exc)!r}"
                robot.events.notify("worker", f"{text}; it is started again", "error")
            await asyncio.sleep(SESSION_RESTART_S)

    # Robots

    @property
    def first(self) -> RobotSession:
        """The robot that is meant where none is named."""
        return next(iter(self.robots.values()))

    def robot(self, name: str) -> RobotSession:
        """Raises Unknown."""
        if name not in self.robots:
            raise Unknown(f"this station has no robot {shown(name)}; GET /robots lists them")
        return self.robots[name]

    def stop(self) -> None:
        """Motors off, of every robot."""
        for robot in self.robots.values():
            robot.driving.stop()

    # Navigations and maps

    async def stop_navigation(self, navigation_id: str) -> NavigationRecord:
        """End the recording of a navigation, whichever robot drives it. Raises Unknown, Conflict."""
        navigation = self.navigations.get(navigation_id)
        for robot in self.robots.values():
            current = robot.current_navigation
            if current.running is not None and current.running.id == navigation_id:
                return await current.stop(navigation_id)
        self.navigations.require_here(navigation_id)
        raise Conflict(f"{navigation.name} is not being recorded (it is {navigation.state})")

    def cancel_navigation(self, navigation_id: str) -> NavigationRecord:
        """Give up what SLAM still computes of a navigation whose recording has ended. Raises Unknown, Conflict."""
        self.navigations.require_here(navigation_id)
        return self._robot_of(self.navigations.get(navigation_id)).current_navigation.cancel(navigation_id)

    def build_map(
        self, navigation_ids: list[str], name: str, mode: PlacesMode | None, activate: bool, places: PlaceGrain
    ) -> Job:
        """Places from finished navigations, in the background. Raises Unknown, Conflict."""
        navigations = [self.navigations.ready(navigation_id) for navigation_id in dict.fromkeys(navigation_ids)]
        folders = [self.navigations.library.navigation_folder(navigation.id) for navigation in navigations]
        title = f"map of {', '.join(navigation.name for navigation in navigations)}"

        async def work(worker: JobWorker[LibraryProgram]) -> dict[str, Any]:
            address, executor = self.maps.address, self.config.executor
            order = folders, address, name or title, mode, executor, places
            async with self.jobs.beside(worker) as second:
                second.post(LibraryProgram.prepare_index, folders)
                built = await worker.call(LibraryProgram.build_map, *order)
                self.events.changed("map")
                indexing = worker if second.is_ended else second
                try:
                    await indexing.call(LibraryProgram.index_map, folders, address, built.map_id)
                except RobotSystemError as exc:  # the map is there; localisation makes what is missing
                    self._without(worker, f"the index of {built.name} is made later", exc)
            if activate:
                await self.use_maps(built.map_id)
            try:
                if await worker.call(LibraryProgram.read_plates, address, built.map_id):
                    await self.maps.refresh(built.map_id)
                    self._regroup()
            except RobotSystemError as exc:  # the map is there, and may be in use
                self._without(worker, f"no door plates are read in {built.name}", exc)
            return {"map": built.map_id, "places": built.places}

        return self.jobs.start("build map", title, work)

    def _without(self, worker: JobWorker[LibraryProgram], what: str, exc: RobotSystemError) -> None:
        """A job goes on without one of its steps; a cancelled one ends. To be called where `exc` was caught."""
        if worker.is_ended:
            raise exc
        self.events.notify("map", f"{what}: {exc}", "warning")

    def measure_places(self) -> Job:
        """How surely each place of the active map would be found again, in the background. Raises Conflict."""
        place_map = self.maps.active.require_first().place_map

        async def work(worker: JobWorker[LibraryProgram]) -> dict[str, Any]:
            return await worker.call(LibraryProgram.measure_places, self.maps.address, place_map.id)

        return self.jobs.start("measure places", f"repeatability of the places of {place_map.name}", work)

    def compare(self, first_id: str, second_id: str) -> Job:
        """Find the places of one navigation in another, in the background. Raises Unknown, Conflict."""
        first, second = self.navigations.ready(first_id), self.navigations.ready(second_id)
        if first.id == second.id:
            raise Conflict("two different navigations are needed to compare them; GET /navigations lists them")
        title = f"{second.name} compared with {first.name}"
        setting = (
            f'In this report Navigation1, whose places make the map, is the navigation "{first.name}"; '
            f'Navigation2, in which they are looked for, is "{second.name}".'
        )
        folder = self.navigations.library.navigation_folder

        async def work(worker: JobWorker[LibraryProgram]) -> dict[str, Any]:
            comparison_id, scratch = await asyncio.to_thread(self.comparisons.prepare)
            try:
                navigations = folder(first.id), folder(second.id)
                results = await worker.call(LibraryProgram.compare, *navigations, scratch, title, setting)
                made = summarise(comparison_id, title, (first.id, second.id), results)
                await asyncio.to_thread(self.comparisons.store, made, scratch)
            finally:
                await asyncio.to_thread(self.comparisons.discard, scratch)
            return {"comparison": comparison_id, "matches": made.matches}

        return self.jobs.start("compare", title, work)

    def reprocess(self, navigation_id: str, backend: str | None) -> Job:
        """Run SLAM over a recording again, in the background. Raises Unknown, Conflict."""
        navigation = self.navigations.library.get(navigation_id)
        self.navigations.require_here(navigation_id)
        recording = self.navigations.library.folder(navigation_id) / "recording.mcap"
        if navigation.state in ("recording", "finishing"):
            raise Conflict(f"{navigation.name} is {navigation.state}; wait until it is over")
        if not recording.is_file():
            raise Conflict(f"{navigation.name} has no recording to run SLAM over")
        chosen = backend or self.config.slam.backend
        folder = self.navigations.library.navigation_folder(navigation_id)
        self.navigations.reserve(navigation_id)

        async def work(worker: JobWorker[LibraryProgram]) -> dict[str, Any]:
            try:
                seed, executor = self.config.slam.seed, self.config.executor
                report = await worker.call(
                    LibraryProgram.reprocess, recording, chosen, seed, navigation_id, folder, executor
                )
                navigation = await self.navigations.reprocessed(navigation_id, report)
                await self._robot_of(navigation).current_navigation.view(navigation_id)
            finally:
                self.navigations.release(navigation_id)
            return {"navigation": navigation_id, "landmarks": report.landmarks}

        try:
            return self.jobs.start(
                "reprocess",
                f"SLAM over {navigation.name}",
                work,
                on_failure=lambda _: self.navigations.release(navigation_id),
            )
        except Conflict:
            self.navigations.release(navigation_id)
            raise

    # Calibration

    async def finish_calibration(self, robot: RobotSession, session_id: str) -> Job:
        """Estimate from what a guided session has seen, in the background. Raises Unknown, Conflict."""
        self.jobs.require_room()
        guided = robot.guided_calibration
        session, times_ns = await guided.stop_looking(session_id)

        async def work(worker: JobWorker[LibraryProgram]) -> dict[str, Any]:
            result = await _estimate(worker, session, times_ns)
            guided.change(session_id, lambda now: replace(now, state="done", result=result))
            return {"session": session_id, "accepted": result["accepted"]}

        def fail(why: str) -> None:
            guided.change(session_id, lambda now: replace(now, state="failed", message=why))

        title = f"{ESTIMATED[session.kind]} of {robot.name}"
        try:
            job = self.jobs.start("calibrate", title, work, on_failure=fail)
        except Conflict as exc:
            fail(str(exc))
            raise
        guided.change(session_id, lambda now: replace(now, job=job.id))
        return job

    async def target_page(self, kind: TargetKind, size: PaperSize) -> bytes:
        """A calibration target to print, as PDF."""
        async with self._drawing:  # however many ask: one worker
            if (kind, size) not in self._pages:
                worker: JobWorker[LibraryProgram] = Worker("calibration target", LIBRARY)
                try:
                    await worker.start()
                    self._pages[kind, size] = await worker.call(LibraryProgram.target_page, kind, size)
                finally:
                    await worker.close()
            return self._pages[kind, size]

    def _robot_of(self, navigation: NavigationRecord) -> RobotSession:
        """The robot that drove it, if it is one of ours."""
        return self.robots.get(navigation.robot, self.first)

    async def use_maps(self, *map_ids: str) -> None:
        """Look for the current place in these maps; the places of the first are shown. Raises as `Maps.activate`."""
        await self.maps.activate(map_ids)
        await self._look_in_active_maps()

    # What was deleted

    async def delete_navigation(self, navigation_id: str) -> None:
        """Into the bin. Raises Unknown, Conflict."""
        await self.navigations.delete(navigation_id)
        await self._tidy_bin()

    async def delete_map(self, map_id: str) -> None:
        """Into the bin. Raises Unknown, Conflict."""
        if await self.maps.delete(map_id):
            await self._look_in_active_maps()
        await self._tidy_bin()

    async def restore_navigation(self, navigation_id: str) -> NavigationRecord:
        """Raises Unknown."""
        navigation = await self.navigations.restore(navigation_id)
        await self._look_into_bin()
        return navigation

    async def restore_map(self, map_id: str) -> MapSummary:
        """Raises Unknown."""
        summary = await self.maps.restore(map_id)
        await self._look_into_bin()
        return summary

    async def empty_bin(self, everything: bool) -> None:
        """Delete for good what is due, or everything in the bin. Raises why not, where one could not be: others are."""
        await self._look_into_bin()
        failed: list[RobotSystemError | OSError] = []
        for entry in self.bin.list() if everything else self.bin.due():
            try:
                if entry.kind == "map":
                    await self.maps.purge(entry.id)
                else:
                    await asyncio.to_thread(self.navigations.library.purge, entry.id)
            except (RobotSystemError, OSError) as exc:
                failed.append(exc)
                continue
            logger.info("deleted %s %s for good", entry.kind, entry.id)
        await self._look_into_bin()
        if failed:
            raise failed[0]

    async def _look_into_bin(self) -> None:
        navigations = await asyncio.to_thread(self.navigations.library.deleted)
        maps = await self.maps.deleted()
        there: dict[Kind, list[tuple[str, str]]] = {
            "navigation": [(navigation.id, navigation.name) for navigation in navigations],
            "map": [(summary.id, summary.name) for summary in maps],
        }
        try:
            await asyncio.to_thread(self.bin.update, there, time.time(), time.monotonic())
        except DataError as exc:  # what was deleted is, and on a full disk the bin is what there is to empty
            text = f"when something was deleted will be forgotten at the next start: {exc}"
            self.events.notify("map", text, "warning")
        self.events.changed("bin")

    async def rename_place(self, place_id: str, name: str) -> PlacesEdit:
        """Raises Conflict, Unknown, DataError."""
        edit = await self.maps.rename_place(place_id, name)
        self._regroup()
        return edit

    async def hide_place(self, place_id: str, hidden: bool) -> PlacesEdit:
        """Never answer with this place, or do again. Raises Conflict, Unknown, DataError."""
        edit = await self.maps.hide_place(place_id, hidden)
        self._regroup()
        self.events.notify("map", f"{edit.active.place(place_id).name} is {'hidden' if hidden else 'shown again'}")
        return edit

    async def merge_places(self, place_ids: list[str]) -> PlacesEdit:
        """Several places become the first of them. Raises Conflict, Unknown, DataError."""
        edit = await self.maps.merge_places(place_ids)
        self._regroup()
        self.events.notify("map", f"{len(set(place_ids))} places are {edit.active.place(place_ids[0]).name} now")
        return edit

    async def rename_room(self, room_id: str, name: str | None) -> PlacesEdit:
        """None: as a room is called that nobody named. Raises Conflict, Unknown, DataError."""
        edit = await (self.maps.take_room_name_back(room_id) if name is None else self.maps.rename_room(room_id, name))
        self._regroup()
        return edit

    async def merge_rooms(self, room_ids: list[str]) -> PlacesEdit:
        """Several rooms become the first of them. Raises Conflict, Unknown, DataError."""
        edit = await self.maps.merge_rooms(room_ids)
        self._regroup()
        self.events.notify("map", f"{len(set(room_ids))} rooms are {edit.active.room(room_ids[0]).name} now")
        return edit

    async def split_room(self, line: FloatArray) -> PlacesEdit:
        """Draw a door. Raises Conflict, DataError."""
        edit = await self.maps.split_room(line)
        self._regroup()
        self.events.notify("map", "a door was drawn")
        return edit

    async def erase_door(self, door_id: str) -> PlacesEdit:
        """Two rooms become one. Raises Conflict, Unknown, DataError."""
        edit = await self.maps.erase_door(door_id)
        self._regroup()
        self.events.notify("map", "a door was erased")
        return edit

    async def undo_places(self, version: int | None, of_map: str | None = None) -> PlacesChange:
        """Take back the newest change of places or rooms. Raises Conflict."""
        change = await self.maps.undo(version, of_map)
        self._regroup()
        self.events.notify("map", f"taken back: {change.why}")
        return change

    def _regroup(self) -> None:
        for robot in self.robots.values():
            robot.regroup()

    async def _look_in_active_maps(self) -> None:
        await asyncio.gather(*(robot.look_in_active_maps() for robot in self.robots.values()))

    async def _every_hour(self) -> None:
        while True:
            await asyncio.sleep(BIN_CHECK_S)
            await self._tidy_bin()

    async def _tidy_bin(self) -> None:
        """A disk or a database that is away, or takes no writes, must not end the robots nor keep the maps hidden."""
        try:
            await self.empty_bin(everything=False)
        except (RobotSystemError, OSError) as exc:
            self.events.notify("map", f"what is due in the bin could not be deleted for good: {exc}", "warning")

    async def _tidy_up(self, interrupted: list[NavigationRecord]) -> None:
        """Remove what a killed station left half-written, recover what it cut off, remove what is beyond the limits."""
        await asyncio.to_thread(remove_scratch, self.config.data_dir)
        try:
            await self.maps.tidy_up()
        except DataError as exc:
            logger.warning("what killed builds left in the maps stays: %s", exc)
        await recover_recordings(self.navigations, interrupted, self.events)
        await retain_recordings(self.navigations.library, self.config.recordings, self.events)


async def _estimate(
    worker: JobWorker[LibraryProgram], session: CalibrationSession, times_ns: list[int]
) -> dict[str, Any]:
    """What a guided calibration comes to, from the pictures of these times or all that was recorded."""
    folder, target, camera = session.folder, session.target, session.told.camera
    if session.kind == "check":
        return await worker.call(LibraryProgram.check_calibration, folder)
    if target is None or camera is None:
        return await worker.call(LibraryProgram.calibrate_imu, folder)
    if session.kind == "camera":
        return await worker.call(LibraryProgram.calibrate_camera, folder, times_ns, target, camera)
    if session.kind == "wheels":
        return await worker.call(LibraryProgram.calibrate_wheels, folder, target)
    return await worker.call(LibraryProgram.calibrate_camera_imu, folder, target, camera)


def _first_cause(error: BaseException) -> BaseException:
    return _first_cause(error.exceptions[0]) if isinstance(error, BaseExceptionGroup) else error


def open_recorder(path: Path, limits: RecordingConfig) -> NavigationRecorder | None:
    """The MCAP recorder of a navigation. Raises DataError when the file cannot be made, or the disk is nearly full."""
    return Recorder(path, min_free_bytes=limits.keep_free_mb * 2**20)
