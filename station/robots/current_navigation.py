"""Drives: recording what the robot sends, following it with SLAM, finishing it; the event loop is never held up."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from shared.errors import RobotSystemError
from shared.geometry import FloatArray
from shared.messages import CameraFrame, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from station.config import RecordingConfig, SlamConfig, choose_backend
from station.errors import Conflict
from station.events import Level, LogLine, Notifier
from station.files.navigation_folder import load_navigation
from station.library.navigation_records import NavigationRecord
from station.library.navigations import Navigations
from station.library.recordings import retain_recordings
from station.model.frames import DriveSample, ImageFrame
from station.model.place_answer import PlaceReport
from station.model.slam_update import SlamUpdate
from station.robots.live_slam import LiveSlam
from station.robots.navigation_files import MakeRecorder, NavigationRecorder, make_navigation, unmake_navigation
from station.robots.slam import SlamProcess
from station.workers.slam_requests import AddDrive, AddFrame, AddImu

logger = logging.getLogger(__name__)
POSE_EVENT_INTERVAL_S = 0.1
AGAIN = "; the recording is kept, and SLAM can run over it again"
CANCELLED = "SLAM was cancelled; the recording is kept, and SLAM can run over it again"
OTHER_ROBOT = "another robot was connected; this navigation ended there"
OTHER_RUN = "the robot was started anew, its clock with it; this navigation ended there"

OTHER_MEANWHILE = "another robot was connected, or this one started anew, just as the recording began; start it again"


@dataclass(slots=True, eq=False)
class _Running:
    """The navigation that is being recorded."""

    navigation: NavigationRecord
    slam: SlamProcess
    live: LiveSlam
    recorder: NavigationRecorder | None
    hello: Hello
    first_frame_ns: int | None = None
    last_frame_ns: int = 0
    num_frames: int = 0
    num_imu: int = 0
    imu_lost: int = 0
    told_pose_s: float = 0.0
    lost_announced: set[str] = field(default_factory=set)
    is_cancelled: bool = False  # while it was finished


@dataclass(frozen=True, slots=True, eq=False)
class _Finishing:
    """A navigation whose recording has ended and whose SLAM has not."""

    running: _Running
    why: str  # the recording ended, in a sentence, where it was not a person who asked


@dataclass(slots=True, eq=False)
class _Beginning:
    """A navigation whose files are being made."""

    hello: Hello
    task: asyncio.Task[NavigationRecord] | None = None
    is_void: bool = False  # another robot, or another run of it, has come meanwhile


class Recording:
    """Records the navigations of one robot, one at a time; what SLAM says of the newest is in `live`."""

    def __init__(
        self,
        navigations: Navigations,
        config: SlamConfig,
        events: Notifier,
        make_recorder: MakeRecorder,
        on_pose: Callable[[int, FloatArray, int], None],
        recordings: RecordingConfig | None = None,
        robot: str = "",
    ) -> None:
        """`robot` is the name whose navigations these are."""
        self._robot = robot
        self._recordings = recordings or RecordingConfig()
        self._navigations = navigations
        self._library = navigations.library
        self._config = config
        self._events = events
        self._make_recorder = make_recorder
        self._on_pose = on_pose
        self._running: _Running | None = None
        self._finishing: dict[str, _Finishing] = {}
        self._tasks: set[asyncio.Task[None]] = set()  # that finish drives, until all of it is kept
        self._beginning: _Beginning | None = None
        self._is_closed = False
        self._times_shown = 0
        self.live: LiveSlam | None = None

    @property
    def slam_pid(self) -> int | None:
        """The SLAM worker of the navigation being recorded."""
        return None if self._running is None else self._running.slam.pid

    @property
    def running(self) -> NavigationRecord | None:
        """The navigation being recorded."""
        return None if self._running is None else self._running.navigation

    @property
    def left_to_do(self) -> str:
        """How far SLAM is with the navigation of `live` while it finishes that, in a sentence; else empty."""
        finishing = None if self.live is None else self._finishing.get(self.live.navigation_id)
        return "" if finishing is None else _left_to_do(finishing.running)

    @property
    def is_busy(self) -> bool:
        """A navigation is being recorded, or about to be."""
        return self._running is not None or self._beginning is not None

    async def start(self, hello: Hello, name: str) -> NavigationRecord:
        """Begin a navigation; it is kept when this returns. Raises DataError when there is no room for it.

        Conflict when one is being recorded, or when the robot changes meanwhile.
        """
        if self._running is not None:
            raise Conflict(f"{self._running.navigation.name} is being recorded; stop it first")
        if self._beginning is not None:
            raise Conflict("a navigation is just being begun; stop it first")
        beginning = self._beginning = _Beginning(hello)
        beginning.task = asyncio.create_task(self._begin(beginning, name), name="begin a navigation")
        return await asyncio.shield(beginning.task)  # half a navigation is nobody's

    async def _begin(self, beginning: _Beginning, name: str) -> NavigationRecord:
        hello = beginning.hello
        try:
            backend = choose_backend(self._config.backend, hello.calibration)
            navigation, recorder = await self._navigations.in_order(
                make_navigation, self._library, self._make_recorder, hello, name, backend, self._robot
            )
            if beginning.is_void or self._is_closed:
                await self._navigations.in_order(unmake_navigation, self._library, navigation, recorder)
                raise Conflict(OTHER_MEANWHILE if beginning.is_void else "the station is ending")
        finally:
            self._beginning = None
        self._library.remember(navigation)
        if recorder is not None:
            recorder.on_connected(hello)
        live = LiveSlam(navigation.id)
        slam = SlamProcess(
            f"SLAM {self._robot or navigation.id}",
            self._config,
            hello.calibration,
            self._events,
            on_update=lambda update: self._on_update(live, update),
            on_trouble=live.say,
            on_restart=live.restart,
        )
        running = self._running = _Running(navigation, slam, live, recorder, hello)
        self._navigations.begin(navigation.id, lambda: self._counted(running))
        self.live = live
        self._navigations.tell(navigation)
        self._events.changed("landmarks")
        self._events.notify("navigation", f"recording {navigation.name}")
        return navigation

    async def stop(self, navigation_id: str) -> NavigationRecord:
        """End recording; SLAM finishes in the background. Raises Unknown, or Conflict when it is not being recorded."""
        navigation = self._library.get(navigation_id)
        running = self._running
        if running is None or running.navigation.id != navigation_id:
            raise Conflict(f"{navigation.name} is not being recorded (it is {navigation.state})")
        kept = self._end(running, "")
        navigation = running.navigation
        await kept
        return navigation

    def cancel(self, navigation_id: str) -> NavigationRecord:
        """Give up what SLAM still computes of a navigation; its recording stays.

        Raises Unknown; Conflict when SLAM computes nothing of it, not yet or not any more.
        """
        navigation = self._library.get(navigation_id)
        finishing = self._finishing.get(navigation_id)
        if finishing is None:
            raise Conflict(f"{navigation.name} is not being finished (it is {navigation.state})")
        if not finishing.running.slam.give_up():
            raise Conflict(f"SLAM has ended for {navigation.name} already; there is nothing left to cancel")
        finishing.running.is_cancelled = True
        return navigation

    def _end(self, running: _Running, why: str) -> asyncio.Future[None]:
        """End recording; `why` in a sentence where it was not a person who asked. Done when that is kept."""
        self._running = None
        self._navigations.end(running.navigation.id)
        message = "; ".join(filter(None, (why, _left_to_do(running))))
        running.navigation = navigation = replace(self._counted(running), state="finishing", message=message)
        # First what closes recorder and SLAM: nothing that fails here may leave them open.
        task = asyncio.create_task(self._finish(running, navigation, why), name=f"finish {navigation.id}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._finishing[navigation.id] = _Finishing(running, why)
        if why:
            self._events.notify("navigation", f"{navigation.name}: {why}", "warning")
        kept = self._navigations.keep(navigation)
        self._events.changed("pose")  # SLAM's state is another one
        return kept

    async def show(self, navigation_id: str) -> None:
        """Let `live` be a finished navigation, unless one is being recorded."""
        if self._running is not None:
            return
        self.live = await asyncio.to_thread(_view_of, self._library.navigation_folder(navigation_id))
        self._times_shown += 1
        self.live.source = f"{navigation_id}/again-{self._times_shown}"  # another cloud than before
        self._events.changed("pose")
        self._events.changed("landmarks")

    async def close(self) -> None:
        """The station ends: the recording is closed, unfinished SLAM is given up and said so."""
        self._is_closed = True
        if self._beginning is not None and self._beginning.task is not None:
            await asyncio.wait({self._beginning.task})
        if self._running is not None:
            running, self._running = self._running, None
            self._navigations.end(running.navigation.id)
            await self._close_recorder(running)
            await running.slam.close(at_once=True)
            message = "; ".join(filter(None, (f"the station was stopped{AGAIN}", _error_of(running))))
            await self._navigations.keep(replace(self._counted(running), state="failed", message=message))
        await asyncio.sleep(0)  # a task that is cancelled before its first step closes nothing
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

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
        running.slam.post(AddFrame(image))

    def on_imu(self, batch: ImuBatch) -> None:
        running = self._running
        if running is None:
            return
        if running.recorder is not None:
            running.recorder.on_imu(batch)
        running.num_imu += len(batch.samples)
        s = batch.samples
        kept = running.slam.post(AddImu([x.t_robot_ns for x in s], [x.gyro_imu for x in s], [x.accel_imu for x in s]))
        if not kept and "imu" not in running.lost_announced:
            running.lost_announced.add("imu")
            self._events.notify(
                "slam", "SLAM is too slow: inertial samples wait too long and are lost to it", "warning"
            )

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
        running.slam.post(AddDrive(DriveSample(applied.t_robot_ns, applied.linear, applied.angular)))

    def on_connected(self, hello: Hello) -> None:
        running, beginning = self._running, self._beginning
        if beginning is not None and beginning.hello.session_id != hello.session_id:
            beginning.is_void = True
        if running is not None and running.hello.robot_id != hello.robot_id:
            self._end(running, OTHER_ROBOT)
        elif running is not None and running.hello.session_id != hello.session_id:
            self._end(running, OTHER_RUN)
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

    def on_command(self, driver: str, linear: float, angular: float, ttl_ms: int) -> None:
        for recorder in self._recorders():
            recorder.on_command(driver, linear, angular, ttl_ms)

    def on_answer(self, report: PlaceReport) -> None:
        for recorder in self._recorders():
            recorder.on_answer(report)

    def on_log(self, line: LogLine) -> None:
        for recorder in self._recorders():
            recorder.on_log(line)

    def refresh(self) -> None:
        """Once a second: the counts of the running navigation, and how far those are whose SLAM finishes."""
        if self._running is not None:
            self._running.navigation = self._counted(self._running)
            self._navigations.tell(self._running.navigation)
            self._tell_recorder_error(self._running)
        for finishing in self._finishing.values():
            running = finishing.running
            message = "; ".join(filter(None, (finishing.why, _left_to_do(running))))
            if message != running.navigation.message:
                running.navigation = replace(running.navigation, message=message)
                self._library.remember(running.navigation)
                self._navigations.tell(running.navigation)
                self._events.changed("pose")

    def _tell_recorder_error(self, running: _Running) -> None:
        error = "" if running.recorder is None else running.recorder.error
        if error and "recorder" not in running.lost_announced:
            running.lost_announced.add("recorder")
            self._events.notify("navigation", error, "error")

    def _on_update(self, live: LiveSlam, update: SlamUpdate) -> None:
        has_new_points = live.update(update)
        if self.live is not live:
            return
        for recorder in self._recorders():
            recorder.on_slam(update)
        if update.T_world_body is not None:
            self._on_pose(update.t_robot_ns, update.T_world_body, update.segment)
        now_s = time.monotonic()
        running = self._running
        if running is not None and now_s - running.told_pose_s >= POSE_EVENT_INTERVAL_S:
            running.told_pose_s = now_s
            self._events.changed("pose")
        if has_new_points:
            self._events.changed("landmarks")

    async def _finish(self, running: _Running, navigation: NavigationRecord, why: str) -> None:
        try:
            await self._close_recorder(running)
            folder = self._library.navigation_folder(navigation.id)
            report = await running.slam.finish(navigation.id, folder)
            finished = await asyncio.to_thread(_view_of, folder)
            said = [why, _error_of(running), _restarted(running.slam), *report.messages, _refused(running.slam)]
            navigation = replace(
                navigation,
                state="ready",
                landmarks=report.landmarks,
                scale=report.scale,
                message="; ".join(filter(None, said)) or f"{report.landmarks} landmarks",
            )
            if self.live is running.live:
                self.live = finished
            self._events.notify("navigation", f"{navigation.name} is ready: {report.landmarks} landmarks")
        except (RobotSystemError, OSError) as exc:
            cause = CANCELLED if running.is_cancelled else running.slam.trouble or str(exc)
            said = [why, _error_of(running), cause, _refused(running.slam)]
            navigation = replace(navigation, state="failed", message="; ".join(filter(None, said)))
            running.live.message = navigation.message
            level: Level = "warning" if running.is_cancelled else "error"
            self._events.notify("navigation", f"{navigation.name}: {navigation.message}", level)
        finally:
            if navigation.state == "finishing":
                text = f"the station was stopped before this navigation was finished{AGAIN}"
                navigation = replace(navigation, state="failed", message=text)
            await running.slam.close(at_once=navigation.state == "failed")
            self._finishing.pop(navigation.id, None)
            kept = self._navigations.keep(navigation)
            self._events.changed("pose")
            self._events.changed("landmarks")
            await kept
        await retain_recordings(self._library, self._recordings, self._events)

    def _recorders(self) -> tuple[NavigationRecorder, ...]:
        """The open recorder, or none."""
        running = self._running
        return () if running is None or running.recorder is None else (running.recorder,)

    async def _close_recorder(self, running: _Running) -> None:
        if running.recorder is not None:
            await asyncio.to_thread(running.recorder.close)
            self._tell_recorder_error(running)

    def _counted(self, running: _Running) -> NavigationRecord:
        first_ns = running.first_frame_ns
        return replace(
            running.navigation,
            frames=running.num_frames,
            frames_skipped=running.slam.frames_dropped,
            imu_samples=running.num_imu,
            imu_lost=running.imu_lost,
            slam_failures=running.slam.failures,
            duration_s=0.0 if first_ns is None else (running.last_frame_ns - first_ns) * 1e-9,
        )


def _left_to_do(running: _Running) -> str:
    """How far SLAM is with a navigation whose recording has ended, in a sentence."""
    total = running.num_frames - running.slam.frames_dropped
    waiting = running.slam.frames_waiting
    if waiting:
        return f"finishing: {max(0, total - waiting)} of {total} pictures were looked at"
    return "finishing: computing trajectory and landmarks"


def _error_of(running: _Running) -> str:
    """Why the recording ended by itself, in a sentence."""
    return "" if running.recorder is None else running.recorder.error


def _restarted(slam: SlamProcess) -> str:
    if not slam.restarts:
        return ""
    return "SLAM was lost on the way and knows only the last part: run SLAM over the recording again for all of it"


def _refused(slam: SlamProcess) -> str:
    return f"SLAM refused {slam.failures} pictures or samples: {slam.failure}" if slam.failures else ""


def _view_of(folder: Path) -> LiveSlam:
    """What a finished navigation shows."""
    navigation = load_navigation(folder)
    return LiveSlam.of_finished(navigation, f"finished: {len(navigation.landmarks)} landmarks")
