"""The running station, wired: link → recorder, SLAM worker, localisation worker → answers. Start reading here.

One object with plain methods; the API is a thin layer over it, and so is a test. Nothing here computes: frames go to
worker processes, files to threads, and the event loop only carries messages.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shared.messages import CameraFrame, Capabilities, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from station.access import open_access
from station.bin import Bin, Kind
from station.comparisons import Comparisons, summarise
from station.config import RecordingConfig, StationConfig
from station.drive_library import DriveLibrary, DriveRecord
from station.driving import Driving
from station.events import EventKind, Events
from station.jobs import Job, Jobs
from station.kept_recordings import recover_recordings, retain_recordings
from station.link import LinkState, RobotLink
from station.locating import Locating
from station.mailbox import Broadcast
from station.map_library import Maps, PlacesChange
from station.maps.map import Place
from station.maps.store import MapSummary, StoreAddress
from station.recorder import Recorder
from station.recording import DriveRecorder, Drives
from station.refusals import Conflict, NoRobot, NotCapable
from station.workers import Worker

logger = logging.getLogger(__name__)
STATES: tuple[EventKind, ...] = ("robot", "driver", "pose", "landmarks", "map", "place", "bin")
BIN_CHECK_S = 3600.0
HIJACK_NOTICE = "the simulated robot is asked to be put down elsewhere"


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrame:
    """A camera image and when it came."""

    frame: CameraFrame
    t_station_ns: int  # arrival
    t_captured_ns: int | None  # the capture in the station's clock; None before the clocks are known


class Station:
    """Everything that runs, and what a person can ask of it. Implements LinkListener."""

    def __init__(
        self,
        config: StationConfig,
        make_recorder: Callable[[Path], DriveRecorder | None] | None = None,
        place_servant: str = "station.place_servant:PlaceServant",
    ) -> None:
        """`place_servant` names the class that the localisation worker runs.

        Raises ConfigError: others than this machine would reach it, and it is not set up who may.
        """
        self.config = config
        self.started_s = time.monotonic()
        self.events = Events()
        self.camera: Broadcast[SeenFrame] = Broadcast()
        self.access = open_access(config)
        self.link = RobotLink(
            config.robot.host, config.robot.port, self, station_name=config.name, robots=self.access.robots
        )
        self.driving = Driving(
            self.link,
            config.drive,
            self._capabilities,
            on_driver=lambda driver: self.events.changed("driver", driver),
            on_silence=lambda text: self.events.say("drive", text, "warning"),
            on_command=lambda *command: self.drives.on_command(*command),
        )
        self.applied: DriveApplied | None = None
        self.jobs = Jobs(self.events)
        store = StoreAddress(config.data_dir / "maps", config.store.database, config.store.blobs, config.name)
        self.maps = Maps(store, self.events)
        self.locating = Locating(
            store, config.localization, self.events, place_servant, lambda report: self.drives.on_answer(report)
        )
        self.comparisons = Comparisons(config.data_dir / "comparisons")
        self.bin = Bin(config.data_dir / "bin.json")
        self.drives = Drives(
            DriveLibrary(config.data_dir / "navigations"),
            config.slam,
            self.events,
            make_recorder or (lambda path: open_recorder(path, config.recordings)),
            on_pose=self.locating.odometry,
            recordings=config.recordings,
        )
        self.events.on_line = self.drives.on_log

    async def run(self, started: Callable[[], Any] = lambda: None) -> None:
        """Run until cancelled. The link ends first, and with it the motors; then drives are closed."""
        interrupted = self.drives.library.open()
        for drive in interrupted:
            self.events.say("navigation", f"{drive.name} was interrupted; its recording is kept", "warning")
        await self.maps.open()
        self.bin.open()
        await asyncio.to_thread(self.comparisons.clean)
        await self.empty_bin(everything=False)
        await self._look_in_active_map()
        for kind in STATES:
            self.events.changed(kind)  # who listens from now on is first told how everything is
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self.driving.run(), name="drive timer")
                tasks.create_task(self.link.run(), name="link")
                tasks.create_task(self.locating.run(), name="localisation")
                tasks.create_task(self._every_second(), name="second")
                tasks.create_task(self._every_hour(), name="bin")
                tasks.create_task(self._tidy_up(interrupted), name="recordings")
                tasks.create_task(self.access.door.watch(), name="door")
                started()
        finally:
            await self.drives.close()
            await self.jobs.close()
            await self.locating.close()

    # Robot

    @property
    def robot(self) -> LinkState:
        return self.link.state

    @property
    def head_must_rest(self) -> str:
        """Why the camera head must look straight ahead, in a sentence; empty when it may turn.

        The calibration tells where the camera is while it does; nothing tells the estimation where it is otherwise.
        """
        if self.drives.running is not None:
            return "a drive is being recorded, for which the camera must look straight ahead; stop the recording first"
        if self.maps.active is not None:
            return "the place is being looked for, for which the camera must look straight ahead; choose no map first"
        return ""

    def point(self, driver: str, pan: float, tilt: float) -> None:
        """Point the camera head (rad). Raises as Driving.point, and Conflict while it must look straight ahead."""
        if (pan or tilt) and (reason := self.head_must_rest):
            raise Conflict(reason)
        self.driving.point(driver, pan, tilt)

    def hijack(self, x: float, y: float, yaw: float) -> None:
        """Put a simulated robot down elsewhere. Raises NoRobot, or NotCapable for a real one."""
        able = self._capabilities()
        if able is None:
            raise NoRobot("no robot is connected")
        if not able.hijack:
            raise NotCapable("this robot cannot be moved by a message; only a simulated one can")
        self.driving.stop()
        if not self.link.hijack(x, y, yaw):
            raise NoRobot("the robot is not connected just now; the link comes back by itself")
        self.events.say("hijack", HIJACK_NOTICE, "warning")

    # Navigations and maps

    def start_drive(self, name: str) -> DriveRecord:
        """Record from now on. Raises NoRobot, Conflict."""
        state = self.link.state
        if not state.connected or state.hello is None:
            raise NoRobot("no robot is connected; there is nothing to record")
        if not state.hello.capabilities.camera:
            raise NotCapable("this robot has no camera; SLAM needs one")
        if not self.driving.head_is_centred:
            raise Conflict("the camera looks aside; let it look straight ahead (pan 0, tilt 0) before you record")
        return self.drives.start(state.hello, name)

    def build_map(self, drive_ids: list[str], name: str, mode: str | None, activate: bool) -> Job:
        """Places from finished drives, in the background. Raises Unknown, Conflict."""
        drives = [self._ready(drive_id) for drive_id in dict.fromkeys(drive_ids)]
        folders = [self.drives.library.navigation_folder(drive.id) for drive in drives]
        title = f"map of {', '.join(drive.name for drive in drives)}"

        async def work(worker: Worker) -> dict[str, Any]:
            built = await worker.call("build_map", folders, self.maps.address, name or title, mode)
            self.maps.changed()
            if activate:
                await self.use_map(built.map_id)
            return {"map": built.map_id, "places": built.places}

        return self.jobs.start("build map", title, work)

    def compare(self, first_id: str, second_id: str) -> Job:
        """Find the places of one drive in another, in the background. Raises Unknown, Conflict."""
        first, second = self._ready(first_id), self._ready(second_id)
        if first.id == second.id:
            raise Conflict("two different navigations are needed to compare them; GET /navigations lists them")
        title = f"{second.name} compared with {first.name}"
        setting = (
            f'In this report Navigation1, whose places make the map, is the drive "{first.name}"; '
            f'Navigation2, in which they are looked for, is "{second.name}".'
        )
        folders = [self.drives.library.navigation_folder(drive.id) for drive in (first, second)]

        async def work(worker: Worker) -> dict[str, Any]:
            comparison_id, scratch = await asyncio.to_thread(self.comparisons.prepare)
            try:
                results = await worker.call("compare", *folders, scratch, title, setting)
                made = summarise(comparison_id, title, (first.id, second.id), results)
                await asyncio.to_thread(self.comparisons.keep, made, scratch)
            finally:
                await asyncio.to_thread(self.comparisons.discard, scratch)
            return {"comparison": comparison_id, "matches": made.matches}

        return self.jobs.start("compare", title, work)

    def reprocess(self, drive_id: str, backend: str | None) -> Job:
        """Run SLAM over a recording again, in the background; then the drive is ready. Raises Unknown, Conflict."""
        drive = self.drives.library.get(drive_id)
        recording = self.drives.library.folder(drive_id) / "recording.mcap"
        if drive.state in ("recording", "finishing"):
            raise Conflict(f"{drive_id} is {drive.state}; wait until it is over")
        if not recording.is_file():
            raise Conflict(f"{drive_id} has no recording to run SLAM over")
        chosen = backend or self.config.slam.backend
        folder = self.drives.library.navigation_folder(drive_id)
        self.drives.reserve(drive_id)

        async def work(worker: Worker) -> dict[str, Any]:
            try:
                arguments = (recording, chosen, self.config.slam.seed, drive_id, folder)
                report = await worker.call("reprocess", *arguments)
                await self.drives.reprocessed(drive_id, report)
            finally:
                self.drives.release(drive_id)
            return {"navigation": drive_id, "landmarks": report.landmarks}

        try:
            return self.jobs.start("reprocess", f"SLAM over {drive.name}", work)
        except Conflict:
            self.drives.release(drive_id)
            raise

    def _ready(self, drive_id: str) -> DriveRecord:
        drive = self.drives.library.get(drive_id)
        if drive.state != "ready":
            raise Conflict(f"{drive_id} is {drive.state}, not ready: {drive.message}")
        return drive

    async def use_map(self, map_id: str | None) -> None:
        """Look for the current place in this map. Raises Unknown, DataError."""
        await self.maps.activate(map_id)
        await self._look_in_active_map()

    # What was deleted

    async def delete_drive(self, drive_id: str) -> None:
        """Into the bin. Raises Unknown, Conflict."""
        await self.drives.delete(drive_id)
        await self.empty_bin(everything=False)

    async def delete_map(self, map_id: str) -> None:
        """Into the bin. Raises Unknown, Conflict."""
        await self.maps.delete(map_id)
        await self.empty_bin(everything=False)

    async def restore_drive(self, drive_id: str) -> DriveRecord:
        """Raises Unknown."""
        drive = await self.drives.restore(drive_id)
        await self._look_into_bin()
        return drive

    async def restore_map(self, map_id: str) -> MapSummary:
        """Raises Unknown."""
        summary = await self.maps.restore(map_id)
        await self._look_into_bin()
        return summary

    async def empty_bin(self, everything: bool) -> None:
        """Delete for good what is due, or everything in the bin."""
        await self._look_into_bin()
        for entry in self.bin.list() if everything else self.bin.due(time.time()):
            if entry.kind == "map":
                await self.maps.purge(entry.id)
            else:
                await asyncio.to_thread(self.drives.library.purge, entry.id)
            logger.info("deleted %s %s for good", entry.kind, entry.id)
        await self._look_into_bin()

    async def _look_into_bin(self) -> None:
        drives = await asyncio.to_thread(self.drives.library.deleted)
        maps = await self.maps.deleted()
        there: dict[Kind, list[tuple[str, str]]] = {
            "navigation": [(drive.id, drive.name) for drive in drives],
            "map": [(summary.id, summary.name) for summary in maps],
        }
        await asyncio.to_thread(self.bin.update, there, time.time())
        self.events.changed("bin")

    async def rename_place(self, place_id: str, name: str) -> Place:
        """Raises Conflict, Unknown, DataError."""
        place = await self.maps.rename_place(place_id, name)
        self._regroup()
        return place

    async def hide_place(self, place_id: str, hidden: bool) -> Place:
        """Never answer with this place, or do again. Raises Conflict, Unknown, DataError."""
        place = await self.maps.hide_place(place_id, hidden)
        self._regroup()
        self.events.say("map", f"{place.name} is {'hidden' if hidden else 'shown again'}")
        return place

    async def merge_places(self, place_ids: list[str]) -> Place:
        """Several places become the first of them. Raises Conflict, Unknown, DataError."""
        place = await self.maps.merge_places(place_ids)
        self._regroup()
        self.events.say("map", f"{len(set(place_ids))} places are {place.name} now")
        return place

    async def undo_places(self, version: int | None) -> PlacesChange:
        """Take back the newest change of the places. Raises Conflict."""
        change = await self.maps.undo(version)
        self._regroup()
        self.events.say("map", f"taken back: {change.why}")
        return change

    def _regroup(self) -> None:
        place_map = self.maps.require_active().place_map
        self.locating.regroup(place_map.places, place_map.edges)

    async def _look_in_active_map(self) -> None:
        active = self.maps.active
        if active is not None:
            self.driving.centre_head()
        self.events.changed("robot")
        await self.locating.use(None if active is None else active.place_map.id)

    # LinkListener: called on the event loop, returns at once

    def on_connected(self, hello: Hello) -> None:
        self.drives.on_connected(hello)
        self.locating.on_connected(hello)
        self.events.say("link", f"connected to {hello.name}")
        self.events.changed("robot")

    def on_disconnected(self, reason: str) -> None:
        self.drives.on_disconnected(reason)
        self.locating.on_disconnected(reason)
        self.events.say("link", f"robot lost: {reason}", "warning")
        self.events.changed("robot")

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        self.camera.put(SeenFrame(frame, t_station_ns, self.link.to_station_ns(frame.t_robot_ns)))
        self.drives.on_frame(frame, t_station_ns)
        self.locating.offer(frame)

    def on_imu(self, batch: ImuBatch) -> None:
        self.drives.on_imu(batch)
        self.locating.on_imu(batch)

    def on_gap(self, num_samples: int) -> None:
        self.drives.on_gap(num_samples)
        self.events.say("link", f"{num_samples} inertial samples were lost", "warning")

    def on_drive_applied(self, applied: DriveApplied) -> None:
        self.applied = applied
        self.drives.on_drive_applied(applied)
        self.locating.on_drive_applied(applied)

    def on_status(self, status: Status) -> None:
        self.drives.on_status(status)
        self.events.changed("robot")

    def on_notice(self, notice: ErrorNotice) -> None:
        self.drives.on_notice(notice)
        self.events.say("robot", notice.message, "error" if notice.fatal else "warning")

    def _capabilities(self) -> Capabilities | None:
        state = self.link.state
        return state.hello.capabilities if state.connected and state.hello is not None else None

    async def _every_hour(self) -> None:
        while True:
            await asyncio.sleep(BIN_CHECK_S)
            await self.empty_bin(everything=False)

    async def _tidy_up(self, interrupted: list[DriveRecord]) -> None:
        """Recover what the station's end cut off, then remove what is beyond the limits."""
        await recover_recordings(self.drives.library, interrupted, self.events)
        await retain_recordings(self.drives.library, self.config.recordings, self.events)

    async def _every_second(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            self.drives.refresh()
            self.locating.refresh()
            self.events.changed("robot")


def open_recorder(path: Path, limits: RecordingConfig) -> DriveRecorder | None:
    """The MCAP recorder of a drive. Raises DataError when the file cannot be made, or the disk is nearly full."""
    return Recorder(path, min_free_bytes=limits.keep_free_mb * 2**20)
