"""The navigation of a robot: begun, recorded, followed by SLAM, finished; the event loop is never held up."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from shared.errors import RobotSystemError
from shared.geometry import FloatArray
from shared.messages import Hello
from station.config import RecordingConfig, SlamConfig, choose_backend, follows_head
from station.errors import Conflict
from station.events import Level, LogLine, Notifier
from station.files.navigation_folder import load_navigation
from station.library.navigation_records import NavigationRecord
from station.library.navigations import Navigations
from station.library.recordings import retain_recordings
from station.model.calibration_fit import CalibrationFit
from station.model.place_answer import PlaceReport
from station.model.slam_update import SlamUpdate
from station.robots.link_events import LinkListeners
from station.robots.live_slam import LiveSlam
from station.robots.navigation_files import MakeRecorder, NavigationRecorder, make_navigation, unmake_navigation
from station.robots.running_navigation import RunningNavigation
from station.robots.slam import SlamWorker

POSE_EVENT_INTERVAL_S = 0.1
AGAIN = "; the recording is kept, and SLAM can run over it again"
CANCELLED = "SLAM was cancelled; the recording is kept, and SLAM can run over it again"
OTHER_ROBOT = "another robot was connected; this navigation ended there"
OTHER_RUN = "the robot was started anew, its clock with it; this navigation ended there"
OTHER_CALIBRATION = "the robot was given another calibration; this navigation ended there"
OTHER_MEANWHILE = (
    "another robot was connected, or this one started or calibrated anew, just as the recording began; start it again"
)


@dataclass(slots=True, eq=False)
class _Beginning:
    """A navigation whose files are being made."""

    hello: Hello
    task: asyncio.Task[NavigationRecord] | None = None
    is_void: bool = False  # another robot, or another run of it, has come meanwhile


class CurrentNavigation(LinkListeners):
    """Records the navigations of one robot, one at a time; what SLAM says of the newest is in `live`.

    What the link delivers goes to the navigation that is being recorded.
    """

    def __init__(
        self,
        navigations: Navigations,
        config: SlamConfig,
        events: Notifier,
        make_recorder: MakeRecorder,
        on_pose: Callable[[int, FloatArray, int], None],
        on_fit: Callable[[Hello, CalibrationFit], None] = lambda _hello, _fit: None,
        recordings: RecordingConfig | None = None,
        robot: str = "",
    ) -> None:
        """`robot` is the name whose navigations these are.

        `on_fit` gets what SLAM says of the calibration that was told in this hello.
        """
        super().__init__()
        self._robot = robot
        self._recordings = recordings or RecordingConfig()
        self._navigations = navigations
        self._library = navigations.library
        self._config = config
        self._events = events
        self._make_recorder = make_recorder
        self._on_pose = on_pose
        self._on_fit = on_fit
        self._running: RunningNavigation | None = None
        self._finishing: dict[str, RunningNavigation] = {}  # their recording has ended and their SLAM has not
        self._tasks: dict[str, asyncio.Task[None]] = {}  # that finish navigations, until all of it is kept
        self._beginning: _Beginning | None = None
        self._is_closed = False
        self._times_viewed = 0
        self._pose_notified_s = 0.0
        self.live: LiveSlam | None = None

    @property
    def slam_pid(self) -> int | None:
        """The SLAM worker of the navigation being recorded."""
        return None if self._running is None else self._running.slam.pid

    @property
    def running(self) -> NavigationRecord | None:
        return None if self._running is None else self._running.record

    @property
    def left_to_do(self) -> str:
        """How far SLAM is with the navigation of `live` while it finishes that, in a sentence; else empty."""
        finishing = None if self.live is None else self._finishing.get(self.live.navigation_id)
        return "" if finishing is None else finishing.left_to_do

    @property
    def is_busy(self) -> bool:
        """A navigation is being recorded, or about to be."""
        return self._running is not None or self._beginning is not None

    @property
    def head_must_rest(self) -> bool:
        """A navigation is being recorded, or about to be, whose SLAM takes the camera where the calibration has it."""
        recorded = self._running or self._beginning
        return recorded is not None and not follows_head(self._config.backend, recorded.hello.calibration)

    async def start(self, hello: Hello, name: str) -> NavigationRecord:
        """Begin a navigation; it is kept when this returns. Raises DataError when there is no room for it.

        Conflict when one is being recorded, or when the robot changes meanwhile.
        """
        if self._running is not None:
            raise Conflict(f"{self._running.record.name} is being recorded; stop it first")
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
        slam = SlamWorker(
            f"SLAM {self._robot or navigation.id}",
            self._config,
            hello.calibration,
            self._events,
            on_update=lambda update: self._on_update(live, hello, update),
            on_trouble=live.set_message,
            on_restart=live.restart,
        )
        running = self._running = RunningNavigation(navigation, hello, slam, live, recorder, self._events)
        self.listeners = running.listeners
        self._pose_notified_s = 0.0
        self._navigations.begin(navigation.id, running.counted)
        self.live = live
        self._navigations.notify(navigation)
        self._events.changed("landmarks")
        self._events.notify("navigation", f"recording {navigation.name}")
        return navigation

    async def stop(self, navigation_id: str) -> NavigationRecord:
        """End recording; SLAM finishes in the background. Raises Unknown, or Conflict when it is not being recorded."""
        navigation = self._library.get(navigation_id)
        running = self._running
        if running is None or running.record.id != navigation_id:
            raise Conflict(f"{navigation.name} is not being recorded (it is {navigation.state})")
        kept = self._end(running, "")
        navigation = running.record
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
        if not finishing.slam.give_up():
            raise Conflict(f"SLAM has ended for {navigation.name} already; there is nothing left to cancel")
        finishing.is_cancelled = True
        return navigation

    def _end(self, running: RunningNavigation, why: str) -> asyncio.Future[None]:
        """End recording; `why` in a sentence where it was not a person who asked. Done when that is kept."""
        self._forget_running(running)
        running.why_ended = why
        message = _joined(why, running.left_to_do)
        running.record = navigation = replace(running.counted(), state="finishing", message=message)
        # First what closes recorder and SLAM: nothing that fails here may leave them open.
        task = asyncio.create_task(self._finish(running, navigation), name=f"finish {navigation.id}")
        self._tasks[navigation.id] = task
        task.add_done_callback(lambda _: self._tasks.pop(navigation.id, None))
        self._finishing[navigation.id] = running
        if why:
            self._events.notify("navigation", f"{navigation.name}: {why}", "warning")
        kept = self._navigations.store(navigation)
        self._events.changed("pose")  # SLAM's state is another one
        return kept

    def _forget_running(self, running: RunningNavigation) -> None:
        """Nothing more is recorded of it."""
        self._running = None
        self.listeners = ()
        self._navigations.end(running.record.id)

    async def view(self, navigation_id: str) -> None:
        """Let `live` be a finished navigation, unless one is being recorded."""
        if self._running is not None:
            return
        self.live = await asyncio.to_thread(_view_of, self._library.navigation_folder(navigation_id))
        self._times_viewed += 1
        self.live.source = f"{navigation_id}/again-{self._times_viewed}"  # another cloud than before
        self._events.changed("pose")
        self._events.changed("landmarks")

    async def close(self) -> None:
        """The station ends: the recording is closed, unfinished SLAM is given up and said so."""
        self._is_closed = True
        if self._beginning is not None and self._beginning.task is not None:
            await asyncio.wait({self._beginning.task})
        if (running := self._running) is not None:
            self._forget_running(running)
            await running.close_recorder()
            await running.slam.close(at_once=True)
            message = _joined(f"the station was stopped{AGAIN}", running.recorder_error)
            await self._navigations.store(replace(running.counted(), state="failed", message=message))
        await asyncio.sleep(0)  # a task that is cancelled before its first step closes nothing
        tasks = dict(self._tasks)
        for navigation_id in self._finishing:  # what is beyond that is kept: cancelled, it would say "finishing"
            tasks[navigation_id].cancel()
        await asyncio.gather(*tasks.values(), return_exceptions=True)

    def on_connected(self, hello: Hello) -> None:
        running, beginning = self._running, self._beginning
        if beginning is not None and beginning.hello.session_id != hello.session_id:
            beginning.is_void = True
        if running is not None and running.hello.robot_id != hello.robot_id:
            self._end(running, OTHER_ROBOT)
        elif running is not None and running.hello.session_id != hello.session_id:
            self._end(running, OTHER_RUN)
        self.on_calibration(hello)
        super().on_connected(hello)

    def on_calibration(self, hello: Hello) -> None:
        """A navigation is made with one calibration from its first picture to its last."""
        running, beginning = self._running, self._beginning
        if beginning is not None and beginning.hello.calibration != hello.calibration:
            beginning.is_void = True
        if running is not None and running.hello.calibration != hello.calibration:
            self._end(running, OTHER_CALIBRATION)
        super().on_calibration(hello)

    def on_command(self, driver: str, linear: float, angular: float, ttl_ms: int) -> None:
        """What was sent to the robot: m/s, rad/s, ms to live."""
        if (recorder := self._recorder) is not None:
            recorder.on_command(driver, linear, angular, ttl_ms)

    def on_answer(self, report: PlaceReport) -> None:
        if (recorder := self._recorder) is not None:
            recorder.on_answer(report)

    def on_log(self, line: LogLine) -> None:
        if (recorder := self._recorder) is not None:
            recorder.on_log(line)

    def refresh(self) -> None:
        """Once a second: the counts of the running navigation, and how far those are whose SLAM finishes."""
        if self._running is not None:
            self._running.record = self._running.counted()
            self._navigations.notify(self._running.record)
            self._running.notify_recorder_error()
        for finishing in self._finishing.values():
            message = _joined(finishing.why_ended, finishing.left_to_do)
            if message != finishing.record.message:
                finishing.record = replace(finishing.record, message=message)
                self._library.remember(finishing.record)
                self._navigations.notify(finishing.record)
                self._events.changed("pose")

    def _on_update(self, live: LiveSlam, hello: Hello, update: SlamUpdate) -> None:
        has_new_points = live.update(update)
        if self.live is not live:
            return
        if (recorder := self._recorder) is not None:
            recorder.on_slam(update)
        if update.T_world_body is not None and update.scale == "metric":  # places are measured in metres
            self._on_pose(update.t_robot_ns, update.T_world_body, update.segment)
        if update.calibration_fit is not None:
            self._on_fit(hello, update.calibration_fit)
        now_s = time.monotonic()
        if self._running is not None and now_s - self._pose_notified_s >= POSE_EVENT_INTERVAL_S:
            self._pose_notified_s = now_s
            self._events.changed("pose")
        if has_new_points:
            self._events.changed("landmarks")

    async def _finish(self, running: RunningNavigation, navigation: NavigationRecord) -> None:
        why = running.why_ended
        try:
            await running.close_recorder()
            folder = self._library.navigation_folder(navigation.id)
            report = await running.slam.finish(navigation.id, folder)
            finished = await asyncio.to_thread(_view_of, folder)
            known = (running.recorder_error, running.slam_restarted, *report.messages, running.slam_refused)
            navigation = replace(
                navigation,
                state="ready",
                landmarks=report.landmarks,
                scale=report.scale,
                message=_joined(why, *known) or f"{report.landmarks} landmarks",
            )
            if self.live is running.live:
                self.live = finished
                if report.calibration_fit is not None:
                    self._on_fit(running.hello, report.calibration_fit)
            self._events.notify("navigation", f"{navigation.name} is ready: {report.landmarks} landmarks")
        except (RobotSystemError, OSError) as exc:
            cause = CANCELLED if running.is_cancelled else running.slam.trouble or str(exc)
            message = _joined(why, running.recorder_error, cause, running.slam_refused)
            navigation = replace(navigation, state="failed", message=message)
            running.live.message = navigation.message
            level: Level = "warning" if running.is_cancelled else "error"
            self._events.notify("navigation", f"{navigation.name}: {navigation.message}", level)
        finally:
            self._finishing.pop(navigation.id, None)
            if navigation.state == "finishing":
                text = f"the station was stopped before this navigation was finished{AGAIN}"
                navigation = replace(navigation, state="failed", message=text)
            await running.slam.close(at_once=navigation.state == "failed")
            kept = self._navigations.store(navigation)
            self._events.changed("pose")
            self._events.changed("landmarks")
            await kept
        await retain_recordings(self._library, self._recordings, self._events)

    @property
    def _recorder(self) -> NavigationRecorder | None:
        return None if self._running is None else self._running.recorder


def _joined(*sentences: str) -> str:
    """Those that say something."""
    return "; ".join(filter(None, sentences))


def _view_of(folder: Path) -> LiveSlam:
    navigation = load_navigation(folder)
    return LiveSlam.of_finished(navigation, f"finished: {len(navigation.landmarks)} landmarks")
