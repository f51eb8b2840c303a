"""Drives: recording what the robot sends, following it with SLAM, finishing it; the event loop is never held up."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from shared.errors import RobotSystemError
from shared.geometry import FloatArray
from shared.messages import CameraFrame, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from station.config import SlamConfig
from station.drive_library import DriveLibrary, DriveRecord
from station.events import Events
from station.frames import DriveSample, ImageFrame
from station.link import LinkListener
from station.live import LiveSlam
from station.navigation_files import load_navigation
from station.refusals import Conflict
from station.slam.backend import SlamUpdate
from station.workers import Worker

logger = logging.getLogger(__name__)
POSE_EVENT_INTERVAL_S = 0.1
LIVE_BACKENDS = ("ukf",)


class DriveRecorder(LinkListener, Protocol):
    """Writes what the link delivers into a file, in a thread of its own; calls return at once."""

    @property
    def error(self) -> str:
        """Why it ended by itself, in a sentence; empty while it works."""
        ...

    def close(self) -> object: ...


MakeRecorder = Callable[[Path], DriveRecorder | None]


@dataclass(slots=True, eq=False)
class _Running:
    """The drive that is being recorded."""

    drive: DriveRecord
    worker: Worker
    live: LiveSlam
    recorder: DriveRecorder | None
    hello: Hello
    first_frame_ns: int | None = None
    last_frame_ns: int = 0
    num_frames: int = 0
    num_imu: int = 0
    imu_lost: int = 0
    told_pose_s: float = 0.0
    died: str = ""
    beginning: asyncio.Task[None] | None = None
    lost_announced: set[str] = field(default_factory=set)


class Drives:
    """Starts, stops and lists drives; one is recorded at a time. Live SLAM state in `live`."""

    def __init__(
        self,
        library: DriveLibrary,
        config: SlamConfig,
        events: Events,
        make_recorder: MakeRecorder,
        on_pose: Callable[[int, FloatArray, int], None],
    ) -> None:
        self.library = library
        self._config = config
        self._events = events
        self._make_recorder = make_recorder
        self._on_pose = on_pose
        self._running: _Running | None = None
        self._finishing: dict[str, asyncio.Task[None]] = {}
        self.live: LiveSlam | None = None

    @property
    def running(self) -> DriveRecord | None:
        """The drive being recorded."""
        return None if self._running is None else self._running.drive

    def list(self) -> list[DriveRecord]:
        """All drives, oldest first; the running one with its counts of now."""
        return [self.get(drive.id) for drive in self.library.list()]

    def get(self, drive_id: str) -> DriveRecord:
        """Raises Unknown."""
        if self._running is not None and self._running.drive.id == drive_id:
            return self._counted(self._running)
        return self.library.get(drive_id)

    def start(self, hello: Hello, name: str) -> DriveRecord:
        """Begin a drive. Raises Conflict when one is being recorded."""
        if self._running is not None:
            raise Conflict(f"{self._running.drive.id} is being recorded; stop it first")
        drive_id = self.library.new_id()
        drive = DriveRecord(
            id=drive_id,
            name=name or time.strftime("Drive of %-d %b, %H:%M", time.localtime()),
            state="recording",
            started_wall_s=time.time(),
            backend=self._config.backend,
            message="recording",
            robot_id=hello.robot_id,
        )
        live = LiveSlam(drive_id)
        worker = Worker(
            f"SLAM {drive_id}",
            "station.slam_servant:SlamServant",
            limits=self._limits(),
            on_event=lambda update: self._on_update(live, update),
            on_death=lambda reason: self._on_death(drive_id, reason),
        )
        self.library.keep(drive)
        recorder = self._make_recorder(self.library.folder(drive_id) / "recording.mcap")
        if recorder is not None:
            recorder.on_connected(hello)
        self._running = running = _Running(drive, worker, live, recorder, hello)
        self.live = live
        self._tell(drive)
        self._events.changed("landmarks")
        # Asked before the first frame can come; what arrives until SLAM is up waits behind it.
        begun = worker.ask("begin", self._config.backend, hello.calibration, self._config.seed)
        running.beginning = asyncio.create_task(self._begin(running, begun), name=f"begin {drive_id}")
        self._events.say("navigation", f"recording {drive.name}")
        return drive

    def stop(self, drive_id: str) -> DriveRecord:
        """End recording; SLAM finishes in the background. Raises Unknown, or Conflict when it is not being recorded."""
        drive = self.library.get(drive_id)
        running = self._running
        if running is None or running.drive.id != drive_id:
            raise Conflict(f"{drive_id} is not being recorded (it is {drive.state})")
        self._running = None
        drive = replace(self._counted(running), state="finishing", message="computing trajectory and landmarks")
        self._keep(drive)
        self._finishing[drive_id] = asyncio.create_task(self._finish(running, drive), name=f"finish {drive_id}")
        return drive

    async def delete(self, drive_id: str) -> None:
        """Forget a drive. Raises Unknown; Conflict while it is being recorded or finished."""
        drive = self.library.get(drive_id)
        if drive.state in ("recording", "finishing"):
            raise Conflict(f"{drive_id} is {drive.state}; wait until it is over")
        await asyncio.to_thread(self.library.delete, drive_id)
        self._events.forget("navigation", drive_id)
        self._events.changed("navigation", None)

    async def close(self) -> None:
        """The station ends: the recording is closed, unfinished SLAM is given up and said so."""
        if self._running is not None:
            running, self._running = self._running, None
            await self._close_recorder(running)
            await running.worker.close()
            self.library.keep(replace(self._counted(running), state="failed", message="the station was stopped"))
        for task in self._finishing.values():
            task.cancel()
        await asyncio.gather(*self._finishing.values(), return_exceptions=True)

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        running = self._running
        if running is None:
            return
        if running.recorder is not None:
            running.recorder.on_frame(frame, t_station_ns)
        if running.first_frame_ns is None:
            running.first_frame_ns = frame.t_robot_ns
        running.last_frame_ns = frame.t_robot_ns
        image = ImageFrame(running.num_frames, frame.t_robot_ns, frame.exposure_ns, frame.jpeg)
        running.num_frames += 1
        running.worker.post("add_frame", image, kind="frame")

    def on_imu(self, batch: ImuBatch) -> None:
        running = self._running
        if running is None:
            return
        if running.recorder is not None:
            running.recorder.on_imu(batch)
        running.num_imu += len(batch.samples)
        kept = running.worker.post(
            "add_imu",
            [s.t_robot_ns for s in batch.samples],
            [s.gyro_imu for s in batch.samples],
            [s.accel_imu for s in batch.samples],
            kind="imu",
        )
        if not kept and not running.died and "imu" not in running.lost_announced:
            running.lost_announced.add("imu")
            self._events.say("slam", "SLAM is too slow: inertial samples wait too long and are lost to it", "warning")

    def on_gap(self, num_samples: int) -> None:
        running = self._running
        if running is not None:
            running.imu_lost += num_samples
            if running.recorder is not None:
                running.recorder.on_gap(num_samples)

    def on_drive_applied(self, applied: DriveApplied) -> None:
        running = self._running
        if running is None:
            return
        if running.recorder is not None:
            running.recorder.on_drive_applied(applied)
        running.worker.post("add_drive", DriveSample(applied.t_robot_ns, applied.linear, applied.angular))

    def on_connected(self, hello: Hello) -> None:
        for recorder in self._recorders():
            recorder.on_connected(hello)

    def on_disconnected(self, reason: str) -> None:
        for recorder in self._recorders():
            recorder.on_disconnected(reason)

    def on_status(self, status: Status) -> None:
        for recorder in self._recorders():
            recorder.on_status(status)

    def on_notice(self, notice: ErrorNotice) -> None:
        for recorder in self._recorders():
            recorder.on_notice(notice)

    def refresh(self) -> None:
        """Once a second: the counts of the running drive."""
        if self._running is not None:
            self._running.drive = self._counted(self._running)
            self._tell(self._running.drive)
            self._tell_recorder_error(self._running)

    def _tell_recorder_error(self, running: _Running) -> None:
        error = "" if running.recorder is None else running.recorder.error
        if error and "recorder" not in running.lost_announced:
            running.lost_announced.add("recorder")
            self._events.say("navigation", error, "error")

    def _on_update(self, live: LiveSlam, update: SlamUpdate) -> None:
        has_new_points = live.update(update)
        if self.live is not live:
            return
        if update.T_world_body is not None:
            self._on_pose(update.t_robot_ns, update.T_world_body, update.segment)
        now_s = time.monotonic()
        running = self._running
        if running is not None and now_s - running.told_pose_s >= POSE_EVENT_INTERVAL_S:
            running.told_pose_s = now_s
            self._events.changed("pose")
        if has_new_points:
            self._events.changed("landmarks")

    def _on_death(self, drive_id: str, reason: str) -> None:
        running = self._running
        if running is None or running.drive.id != drive_id:
            return
        running.died = reason
        running.live.message = "SLAM was lost; the recording goes on"
        self._events.say("worker", f"{reason}; it is started again, the part before is lost to SLAM", "error")
        asyncio.get_running_loop().create_task(self._restart(running), name="restart SLAM")

    async def _begin(self, running: _Running, begun: asyncio.Future[None]) -> None:
        try:
            await running.worker.start()
            await begun
        except RobotSystemError as exc:
            # The recording goes on: a drive without live SLAM is better than none.
            running.died = str(exc)
            running.live.message = f"SLAM does not run: {exc}"
            self._events.say("slam", running.live.message, "error")

    async def _restart(self, running: _Running) -> None:
        """A new process for the same drive: it knows only what comes from now on."""
        worker = Worker(
            running.worker.name,
            "station.slam_servant:SlamServant",
            limits=self._limits(),
            on_event=lambda update: self._on_update(running.live, update),
        )
        try:
            await worker.start()
            await worker.call("begin", self._config.backend, running.hello.calibration, self._config.seed)
        except RobotSystemError as exc:
            self._events.say("worker", f"SLAM cannot be started again: {exc}", "error")
            return
        running.worker, running.died = worker, ""

    async def _finish(self, running: _Running, drive: DriveRecord) -> None:
        try:
            await self._close_recorder(running)
            if running.beginning is not None:
                await running.beginning
            folder = self.library.navigation_folder(drive.id)
            report = await running.worker.call("finish", drive.id, folder)
            finished = await asyncio.to_thread(_view_of, folder)
            drive = replace(
                drive,
                state="ready",
                landmarks=report.landmarks,
                scale=report.scale,
                message="; ".join(report.messages) or f"{report.landmarks} landmarks",
            )
            if self.live is running.live:
                self.live = finished
            self._events.say("navigation", f"{drive.name} is ready: {report.landmarks} landmarks")
        except RobotSystemError as exc:
            drive = replace(drive, state="failed", message=running.died or str(exc))
            running.live.message = drive.message
            self._events.say("navigation", f"{drive.name}: {drive.message}", "error")
        finally:
            if drive.state == "finishing":
                drive = replace(drive, state="failed", message="the station was stopped before this drive was finished")
            await running.worker.close()
            self._keep(drive)
            self._finishing.pop(drive.id, None)
            self._events.changed("pose")
            self._events.changed("landmarks")

    def _limits(self) -> dict[str, int]:
        """An offline backend may be behind, a live one may not."""
        is_live = self._config.backend in LIVE_BACKENDS
        frames = self._config.live_frame_backlog if is_live else self._config.frame_backlog
        return {"frame": frames, "imu": self._config.imu_backlog}

    def _recorders(self) -> tuple[DriveRecorder, ...]:
        """The open recorder, or none."""
        running = self._running
        return () if running is None or running.recorder is None else (running.recorder,)

    async def _close_recorder(self, running: _Running) -> None:
        if running.recorder is not None:
            await asyncio.to_thread(running.recorder.close)
            self._tell_recorder_error(running)

    def _counted(self, running: _Running) -> DriveRecord:
        first_ns = running.first_frame_ns
        return replace(
            running.drive,
            frames=running.num_frames,
            frames_skipped=running.worker.dropped.get("frame", 0),
            imu_samples=running.num_imu,
            imu_lost=running.imu_lost,
            duration_s=0.0 if first_ns is None else (running.last_frame_ns - first_ns) * 1e-9,
        )

    def _keep(self, drive: DriveRecord) -> None:
        self.library.keep(drive)
        self._tell(drive)

    def _tell(self, drive: DriveRecord) -> None:
        self._events.changed("navigation", drive, drive.id)


def _view_of(folder: Path) -> LiveSlam:
    """What a finished navigation shows."""
    navigation = load_navigation(folder)
    return LiveSlam.of_finished(navigation, f"finished: {len(navigation.landmarks)} landmarks")
