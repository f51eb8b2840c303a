"""A guided calibration: pictures are recorded, a worker looks for the board in them and says what to show next."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import shutil
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from shared.bounded import shown
from shared.calibration import Calibration
from shared.disk import make_folder
from shared.errors import DataError, RobotSystemError
from shared.messages import CameraFrame, DriveApplied, Hello, ImuBatch, ImuSample
from station.calibration.guidance import WITHOUT_BOARD, GuidedKind
from station.calibration.target import Target
from station.errors import Conflict, NotCapable, Unknown
from station.events import Latest, Notifier
from station.library.dated_id import free_dated_id
from station.model.frames import DriveSample, ImageFrame
from station.robots.link_events import LinkListeners, drive_sample
from station.robots.navigation_files import MakeRecorder, NavigationRecorder
from station.workers.calibration_interface import RECORDING, WATCHER, BoardSeen, CalibrationProgram, PrintedBoard
from station.workers.worker import Worker

logger = logging.getLogger(__name__)

LOOK_EVERY_S = 0.2
LONGEST_S = 1800.0  # of one recording: a patient person needs minutes; a page that was closed ends nothing
KEPT_FOLDERS = 5  # of the newest sessions, with their recordings
LONGEST_AT_REST_S = 4 * 3600.0  # of an IMU: half an hour is advised, and nobody need watch it
FELT_S = 1.0  # of inertial samples together
SHOWN: dict[GuidedKind, str] = {
    "camera": "the camera is being calibrated; show it the board",
    "camera-imu": "camera and IMU are being calibrated; wave the robot before the board",
    "wheels": "the wheels are being measured; drive before the board",
    "imu": "the IMU is being measured; leave the robot alone",
    "check": "the calibration is being checked; carry the robot about",
}
MUST_STAND: dict[GuidedKind, str] = {
    "camera": "somebody holds a board before the robot to calibrate it; finish that, or give it up",
    "camera-imu": "somebody holds the robot before a board to calibrate it; finish that, or give it up",
    "wheels": "",  # which are driven
    "imu": "the robot's IMU is being measured at rest; finish that, or give it up",
    "check": "somebody carries the robot about to check its calibration; finish that, or give it up",
}
OTHER_RUN = "the robot was started anew, or another one was connected, or its calibration was changed; begin again"
SessionState = Literal["looking", "estimating", "done", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationSession:
    """One guided calibration, as far as it is."""

    id: str
    kind: GuidedKind
    target: Target | None  # None: without a board
    folder: Path
    told: Calibration  # what the robot told when it began
    robot_id: str
    state: SessionState = "looking"
    message: str = ""  # why it failed, in a sentence
    seen: BoardSeen | None = None  # the newest picture that was looked at
    job: str = ""  # that estimates
    result: dict[str, Any] | None = None  # what the estimate came to


@dataclass(slots=True)
class _Beginning:
    """A session whose worker and recording are being made."""

    hello: Hello
    kind: GuidedKind
    is_void: bool = False  # another robot, another run of it or another calibration came meanwhile


class GuidedCalibration(LinkListeners):
    """The newest session of one robot. What the link delivers is recorded while the board is looked at."""

    def __init__(self, root: Path, events: Notifier, make_recorder: MakeRecorder) -> None:
        super().__init__()
        self._root = root
        self._events = events
        self._make_recorder = make_recorder
        self._hello: Hello | None = None  # of the robot that is recorded
        self._beginning: _Beginning | None = None
        self._recorder: NavigationRecorder | None = None
        self._worker: Worker[CalibrationProgram, None] | None = None
        self._frames: Latest[CameraFrame] = Latest()
        self._looked_s = 0.0  # when the newest picture was looked at, monotonic
        self._felt: list[ImuSample] = []  # where no board is looked at: since they were felt last
        self._drive: list[DriveSample] = []  # where wheels are: since the last picture
        self._looking: asyncio.Task[None] | None = None
        self._ending: asyncio.Task[None] | None = None  # of what a failed session leaves
        self._changing = asyncio.Lock()
        self.session: CalibrationSession | None = None

    @property
    def is_busy(self) -> bool:
        """The board is looked at and what the robot sends is recorded, or about to be."""
        return self._beginning is not None or self._is_looking

    @property
    def _is_looking(self) -> bool:
        return self.session is not None and self.session.state == "looking"

    @property
    def must_stand(self) -> str:
        """Why the robot may not move, in a sentence; empty when it may."""
        if self._beginning is not None:
            return MUST_STAND[self._beginning.kind]
        return MUST_STAND[self.session.kind] if self.session is not None and self._is_looking else ""

    def get(self, session_id: str) -> CalibrationSession:
        """Raises Unknown."""
        if self.session is None or self.session.id != session_id:
            raise Unknown(f"there is no calibration session {shown(session_id)}; GET /calibration/sessions lists it")
        return self.session

    async def start(self, hello: Hello, kind: GuidedKind, board: Target | PrintedBoard | None) -> CalibrationSession:
        """Begin to look and record; an earlier session is over. Raises Conflict, NotCapable, DataError.

        `board`: None for a kind that needs none.
        """
        _require_able(hello, kind)
        if self.is_busy or (self.session is not None and self.session.state == "estimating"):
            raise Conflict("a calibration is going on; finish it, or give it up")
        self._beginning = beginning = _Beginning(hello, kind)
        try:
            async with self._changing:
                return await self._begin(beginning, kind, board)
        finally:
            self._beginning = None

    async def _begin(
        self, beginning: _Beginning, kind: GuidedKind, board: Target | PrintedBoard | None
    ) -> CalibrationSession:
        await self._end()
        hello, folder, target = beginning.hello, None, None
        told = hello.calibration
        try:
            self._worker = worker = Worker("calibration", WATCHER, on_death=self._fail)
            await worker.start()
            if board is not None and told.camera is not None:
                target = await worker.call(CalibrationProgram.begin, kind, board, told.camera)
            else:
                await worker.call(CalibrationProgram.begin_without_board, kind)
            session_id, folder = await asyncio.to_thread(self._make_folder)
            self._recorder = await asyncio.to_thread(self._make_recorder, folder / RECORDING)
            if beginning.is_void:
                raise Conflict(OTHER_RUN)
        except BaseException:
            await self._end()
            if folder is not None:
                await asyncio.to_thread(shutil.rmtree, folder, True)
            raise
        if self._recorder is not None:
            self._recorder.on_connected(hello)
            self.listeners = (self._recorder,)
        self._hello = hello
        self._felt, self._drive = [], []
        self._set(session := CalibrationSession(session_id, kind, target, folder, told, hello.robot_id))
        self._looking = asyncio.create_task(self._look_and_watch(worker, kind), name=f"calibration {session_id}")
        self._events.notify("calibration", SHOWN[kind])
        return session

    async def stop_looking(self, session_id: str) -> tuple[CalibrationSession, list[int]]:
        """End the recording; returns the times (robot clock, ns) of the pictures that count.

        Raises Unknown; Conflict when it looks no longer.
        """
        async with self._changing:
            session = self.get(session_id)
            if session.state != "looking" or self._worker is None:
                raise Conflict(f"this calibration is over ({session.state}); begin a new one")
            times = await self._worker.call(CalibrationProgram.taken)
            self._set(replace(session, state="estimating"))
            try:
                await self._end()
            except Exception as exc:
                self._set(replace(session, state="failed", message=f"the recording could not be closed: {exc}"))
                raise
            return self.get(session_id), times

    async def give_up(self, session_id: str) -> None:
        """Forget it and what was recorded. Raises Unknown; Conflict while it is estimated (cancel its job first)."""
        async with self._changing:
            session = self.get(session_id)
            if session.state == "estimating":
                raise Conflict(f"the estimate is being made; cancel it with DELETE /jobs/{session.job}")
            await self._end()
            await asyncio.to_thread(shutil.rmtree, session.folder, True)
            self.session = None
            self._events.changed("calibration")

    def get_for(self, hello: Hello, session_id: str) -> CalibrationSession:
        """Raises Unknown; Conflict when another robot was calibrated than the one of this hello."""
        session = self.get(session_id)
        if session.robot_id != hello.robot_id:
            raise Conflict("another robot than the present one was calibrated; connect that one again")
        return session

    def change(self, session_id: str, change: Callable[[CalibrationSession], CalibrationSession]) -> None:
        """A new state of this session, if it is still the newest."""
        if self.session is not None and self.session.id == session_id:
            self._set(change(self.session))

    async def close(self) -> None:
        if self._ending is not None:
            await asyncio.wait([self._ending])
        await self._end()

    # What the link delivers, beside the recorder

    def on_connected(self, hello: Hello) -> None:
        self._compare(hello)
        super().on_connected(hello)

    def on_calibration(self, hello: Hello) -> None:
        self._compare(hello)
        super().on_calibration(hello)

    def _compare(self, hello: Hello) -> None:
        """A session is of one run of one robot that tells one calibration."""
        if self._beginning is not None and _differ(self._beginning.hello, hello):
            self._beginning.is_void = True
        if self._hello is not None and _differ(self._hello, hello):
            self._fail(OTHER_RUN)

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        if self.session is not None and self.session.kind == "imu":
            return  # half an hour of pictures would tell nothing
        super().on_frame(frame, t_station_ns)
        if self._is_looking:
            self._frames.put(frame)

    def on_imu(self, batch: ImuBatch) -> None:
        super().on_imu(batch)
        if self.session is not None and self.session.kind in WITHOUT_BOARD and self._is_looking:
            self._felt += batch.samples

    def on_drive_applied(self, applied: DriveApplied) -> None:
        super().on_drive_applied(applied)
        if self.session is not None and self.session.kind == "wheels" and self._is_looking:
            self._drive.append(drive_sample(applied))

    def _fail(self, why: str) -> None:
        if self.session is not None and self._is_looking:
            self._set(replace(self.session, state="failed", message=why))
            self._events.notify("calibration", why, "error")
            self.listeners = ()
            self._ending = asyncio.create_task(self._end_failed(), name="end of a failed calibration")

    async def _end_failed(self) -> None:
        async with self._changing:
            if self.session is not None and self.session.state == "failed":
                await self._end()

    def _set(self, session: CalibrationSession) -> None:
        self.session = session
        self._events.changed("calibration")

    async def _look_and_watch(self, worker: Worker[CalibrationProgram, None], kind: GuidedKind) -> None:
        why, longest_s = "", LONGEST_AT_REST_S if kind == "imu" else LONGEST_S
        looking = asyncio.create_task(self._look_on(worker, self._feel if kind in WITHOUT_BOARD else self._look))
        try:
            async with asyncio.timeout(longest_s):
                while not looking.done() and not (why := "" if self._recorder is None else self._recorder.error):
                    await asyncio.wait([looking], timeout=1.0)
        except TimeoutError:
            why = f"nobody finished it within {longest_s / 60:.0f} minutes; begin again"
        finally:
            looking.cancel()
        if why:
            self._fail(why)

    async def _look_on(
        self,
        worker: Worker[CalibrationProgram, None],
        look: Callable[[Worker[CalibrationProgram, None]], Awaitable[BoardSeen]],
    ) -> None:
        """A few times a second, until something fails."""
        while True:
            try:
                seen = await look(worker)
            except DataError as exc:
                logger.warning("%s", exc)
                continue
            except RobotSystemError as exc:
                self._fail(str(exc))
                return
            if self._is_looking and self.session is not None:
                self._set(replace(self.session, seen=seen))

    async def _look(self, worker: Worker[CalibrationProgram, None]) -> BoardSeen:
        """What the newest picture shows. Raises as CalibrationProgram.look."""
        await asyncio.sleep(self._looked_s + LOOK_EVERY_S - time.monotonic())
        frame = await self._frames.get()
        self._looked_s = time.monotonic()
        if self._drive:
            samples, self._drive = self._drive, []
            await worker.call(CalibrationProgram.drive, samples)
        image = ImageFrame(frame.seq, frame.t_robot_ns, frame.exposure_ns, frame.jpeg)
        return await worker.call(CalibrationProgram.look, image)

    async def _feel(self, worker: Worker[CalibrationProgram, None]) -> BoardSeen:
        """What the inertial samples of the last second say."""
        while not self._felt or self._felt[-1].t_robot_ns - self._felt[0].t_robot_ns < FELT_S * 1e9:
            await asyncio.sleep(0.1)
        s, self._felt = self._felt, []
        gyro, accel = [x.gyro_imu for x in s], [x.accel_imu for x in s]
        return await worker.call(CalibrationProgram.feel, [x.t_robot_ns for x in s], gyro, accel)

    async def _end(self) -> None:
        """Nothing is looked at or recorded any more."""
        self.listeners = ()
        looking, self._looking = self._looking, None
        if looking is not None:
            looking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await looking
        worker, self._worker = self._worker, None
        if worker is not None:
            await worker.close()
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            await asyncio.to_thread(recorder.close)

    def _make_folder(self) -> tuple[str, Path]:
        session_id = free_dated_id("cal", lambda name: (self._root / name).exists())
        folder = self._root / session_id
        try:
            make_folder(folder)
            for old in sorted(self._root.glob("cal-*"))[:-KEPT_FOLDERS]:
                if (
                    time.time() - old.stat().st_mtime > 2 * LONGEST_AT_REST_S
                ):  # else perhaps another robot's, still in use
                    shutil.rmtree(old, ignore_errors=True)
        except OSError as exc:
            raise DataError(f"{folder} cannot be made ({exc.strerror}); give a folder that can be written") from exc
        return session_id, folder


def _require_able(hello: Hello, kind: GuidedKind) -> None:
    """Raises NotCapable, or Conflict with what must be done before."""
    able, camera = hello.capabilities, hello.calibration.camera
    if kind == "imu":
        if not able.imu or hello.calibration.imu is None:
            raise NotCapable("this robot has no IMU to measure")
        return
    if camera is None or not able.camera:
        raise NotCapable("this robot has no camera to calibrate")
    if kind != "camera" and not able.imu:
        raise NotCapable("this robot has no IMU, and what the camera sees is compared with it")
    if kind == "wheels" and not able.drive:
        raise NotCapable("this robot has no motors, and so no wheels to measure")
    if kind != "camera" and not camera.is_measured:
        raise Conflict("the camera's lens is a guess; calibrate the camera first")


def _differ(begun: Hello, now: Hello) -> bool:
    return begun.session_id != now.session_id or begun.calibration != now.calibration
