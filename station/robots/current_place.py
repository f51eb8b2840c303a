"""The current place of a robot: its newest pictures go to the localisation worker, and the last answer is here."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Concatenate

from shared.calibration import Calibration
from shared.errors import RobotSystemError
from shared.geometry import FloatArray
from shared.messages import CameraFrame, DriveApplied, Hello, ImuBatch
from station.config import LocalizationConfig
from station.events import Events, Latest
from station.model.calibration_fit import CalibrationFit, newer
from station.model.frames import DriveSample, ImageFrame
from station.model.map_store import StoreAddress
from station.model.place_answer import HijackNotice, MapLeftOut, MapReading, PlaceReport
from station.model.place_map import Grouping
from station.robots.link_events import IgnoringListener, drive_sample
from station.robots.visits import Visits
from station.workers.place_interface import PLACES, PlaceEvent, PlaceProgram
from station.workers.request import ArgumentsP, Limit, Method, ProgramName, WorkerDied
from station.workers.scheduling import ComputeSlots
from station.workers.worker import Worker

logger = logging.getLogger(__name__)
MAX_QUERY_IMAGES = 32
RESTART_S = 1.0
BACKLOG: dict[Method, Limit] = {
    PlaceProgram.add_imu: Limit(30_000),  # batches: two minutes if each is one sample
    PlaceProgram.add_drive: Limit(2400),  # two minutes
    PlaceProgram.add_pose: Limit(300),
}
OLD_AFTER_S = 15.0  # an answer about a picture of so long ago says nothing of now; a busy machine needs seconds for one
OLD_AFTER_PICTURES = 3  # or about one so many pictures ago, where few are asked for


class CurrentPlace(IgnoringListener):
    """One localisation worker, given the newest picture a few times a second while maps are active.

    Inertial samples and drive commands notice a hijack and carry the estimate.
    """

    def __init__(
        self,
        store: StoreAddress,
        config: LocalizationConfig,
        events: Events,
        program: ProgramName[PlaceProgram, PlaceEvent] = PLACES,
        on_report: Callable[[PlaceReport], None] = lambda _: None,
        slots: ComputeSlots | None = None,
        may_look: Callable[[], bool] = lambda: True,
    ) -> None:
        """`on_report` gets every answer. `slots` are shared by the robots of a station: whose pictures are looked at.

        `may_look`: whether it is known where the camera is; only then a picture tells the place.
        """
        self._may_look = may_look
        self._on_report = on_report
        self._slots = slots or ComputeSlots()
        self._program = program
        self._store = store
        self._config = config
        self._events = events
        self._frames: Latest[tuple[int, CameraFrame]] = Latest()  # with the robot run they belong to
        self._worker: Worker[PlaceProgram, PlaceEvent] | None = None
        self._map_ids: tuple[str, ...] = ()
        self._wanted = asyncio.Event()
        self._calibration: Calibration | None = None
        self.calibration_fit: CalibrationFit | None = None  # as far as the robot's SLAM knows
        self._robot_run: tuple[str, str] | None = None  # robot, session: another one has another clock
        self._drive: DriveSample | None = None  # the newest: it says where the camera's head looks
        self._runs = 0
        self._is_ready = False
        self._generation = 0  # counts the calls of use_maps(): a worker that was killed for another map did not die
        self._lost = 0  # inertial samples
        self._groupings: Latest[Grouping] = Latest()
        self._queries: OrderedDict[int, bytes] = OrderedDict()
        self._report: PlaceReport | None = None
        self._report_s = 0.0  # when it came
        self._num_hijacks = 0  # that the worker there is now has noticed
        self._gone = ""  # why there is no robot, in a sentence
        self._absent = ""  # why there can be no answer about now, in a sentence
        self.visits = Visits(events)
        self.status = "no map is active"
        self.progress: float | None = None  # 0..1 while a map is prepared
        self.answers = 0

    @property
    def pid(self) -> int | None:
        return None if self._worker is None else self._worker.pid

    @property
    def report(self) -> PlaceReport | None:
        """The last answer; without a robot, or with an old picture only, that the place is lost, and why."""
        if self._report is None or not self._absent:
            return self._report
        nowhere = replace(
            self._report.answer,
            state="lost",
            place=None,
            distance=None,
            position_map=None,
            alternatives=(),
            room=None,
            room_alternatives=(),
            one_of_two=(),
            doorway=None,
            forward_map=None,
            sigma_position=None,
            reason=self._absent,
        )
        return replace(self._report, answer=nowhere, T_map_cam=None)

    async def use_maps(self, map_ids: tuple[str, ...]) -> None:
        """Look in these maps from now on; in none, and nowhere."""
        self._map_ids = map_ids
        self._generation += 1
        self._forget()
        self._groupings = Latest()
        self.status = "reading the map" if map_ids else "no map is active"
        self.progress = 0.0 if map_ids else None
        self._events.changed("place")
        self._wanted.set()
        worker, self._worker = self._worker, None  # before we wait: the next one is there soon
        if worker is not None:
            worker.kill()  # it may be in the middle of a map that nobody wants any more
            await worker.close()

    def regroup(self, grouping: Grouping) -> None:
        """Give the worker changed places or rooms of the first of its maps: only those are changed while it is in use.

        It may be busy: its next answer counts, nobody waits for it.
        """
        self._groupings.put(grouping)
        self._events.changed("place")

    def on_connected(self, hello: Hello) -> None:
        """A robot was connected. Nothing that was known of another robot, or in another clock, is of use for it."""
        self._gone = ""
        self.on_calibration(hello)

    def on_calibration(self, hello: Hello) -> None:
        """What was found with another calibration says nothing any more."""
        run = (hello.robot_id, hello.session_id)
        if run != self._robot_run or hello.calibration != self._calibration:
            if run != self._robot_run:
                self._drive = None
            self._robot_run, self._calibration = run, hello.calibration
            self._runs += 1
            self._forget()
            self.calibration_fit = None
            self._post(PlaceProgram.calibrate, hello.calibration)
            if self._drive is not None:
                self._post(PlaceProgram.add_drive, self._drive)
            self._events.changed("place")

    def on_disconnected(self, reason: str) -> None:
        """The answer is about a robot that may be anywhere by now."""
        self._gone = f"the robot is not connected: {reason}"
        self._lose(self._gone)

    def refresh(self, why: str = "") -> None:
        """Now and then: an answer does not stay true by itself. `why`: no picture is looked at, in a sentence."""
        age_s = time.monotonic() - self._report_s
        if not self._absent and age_s > max(OLD_AFTER_S, OLD_AFTER_PICTURES / self._config.rate_hz):
            self._lose(why or "no picture was looked at for a while; is the camera working?")

    def _lose(self, reason: str) -> None:
        if self._report is None:
            return
        self._absent = reason
        if (report := self.report) is not None:
            self.visits.add(report.answer)
        self._events.changed("place")

    def _forget(self) -> None:
        self._report, self._absent = None, ""
        self._queries.clear()

    def receive_pose(self, t_robot_ns: int, T_nav_body: FloatArray, segment: int) -> None:
        """A pose of the running navigation; when they come too quickly the oldest is left out."""
        self._post(PlaceProgram.add_pose, t_robot_ns, T_nav_body, segment)

    def receive_fit(self, fit: CalibrationFit) -> None:
        """What SLAM says of the calibration; a drive that has just begun undoes nothing that an earlier one knows."""
        self.calibration_fit = newer(self.calibration_fit, fit)
        self._post(PlaceProgram.use_fit, self.calibration_fit)

    def on_imu(self, batch: ImuBatch) -> None:
        s = batch.samples
        gyro, accel = [x.gyro_imu for x in s], [x.accel_imu for x in s]
        if not self._post(PlaceProgram.add_imu, [x.t_robot_ns for x in s], gyro, accel):
            self._lost += 1
            if self._lost == 1:
                self._events.notify("place", "localisation is too slow: inertial samples are lost to it", "warning")

    def on_drive_applied(self, applied: DriveApplied) -> None:
        self._drive = drive_sample(applied)
        self._post(PlaceProgram.add_drive, self._drive)

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:  # noqa: ARG002
        """The worker gets the newest picture when it is free."""
        if self._map_ids and self._may_look():
            self._frames.put((self._runs, frame))

    def _post(
        self,
        method: Callable[Concatenate[PlaceProgram, ArgumentsP], None],
        *args: ArgumentsP.args,
        **kwargs: ArgumentsP.kwargs,
    ) -> bool:
        """To the worker, once it knows the map and the robot. False when older ones were dropped for it."""
        return self._worker is None or not self._is_ready or self._worker.post(method, *args, **kwargs)

    def query_image(self, t_robot_ns: int) -> bytes | None:
        """The picture of an earlier answer, while it is kept."""
        return self._queries.get(t_robot_ns)

    async def run(self) -> None:
        while True:
            map_ids, generation = self._map_ids, self._generation
            if not map_ids:
                self._wanted.clear()
                await self._wanted.wait()
                continue
            try:
                await self._serve(map_ids, generation)
            except WorkerDied as exc:
                if self._generation == generation:
                    self.status = "localisation is started again"
                    self._events.notify("worker", f"{exc}; it is started again", "error")
                    await asyncio.sleep(RESTART_S)
            except RobotSystemError as exc:
                if self._generation == generation:
                    self._set_status(f"no localisation: {exc}", None)
                    self._events.notify("place", self.status, "error")
                    self._map_ids = ()

    async def close(self) -> None:
        if self._worker is not None:
            await self._worker.close()

    async def _serve(self, map_ids: tuple[str, ...], generation: int) -> None:
        """One worker, until it dies or other maps are wanted."""
        worker = Worker(
            "localisation",
            self._program,
            limits=BACKLOG,
            on_event=lambda event: self._on_event(event) if self._generation == generation else None,
        )
        self._worker = worker
        self._num_hijacks = 0
        try:
            await worker.start()
            await worker.call(PlaceProgram.load, self._store, map_ids)
            self._set_status("waiting for a picture of the robot", None)
            await self._frames.get()  # from here on a robot is known
            if self._calibration is not None:
                await worker.call(PlaceProgram.calibrate, self._calibration)
                await worker.call(PlaceProgram.use_fit, self.calibration_fit)
            if self._drive is not None:
                await worker.call(PlaceProgram.add_drive, self._drive)
            self._is_ready = True
            self._set_status("looking at the first picture", None)
            self._events.notify("place", "localisation is ready")
            interval_s = 1.0 / self._config.rate_hz
            while self._generation == generation:
                run, frame = await self._frames.get()
                started_s = time.monotonic()
                async with self._slots.hold():
                    if self._frames.is_fresh:  # it came while others computed
                        run, frame = await self._frames.get()
                    if self._groupings.is_fresh:
                        await worker.call(PlaceProgram.regroup, await self._groupings.get())
                    report = await self._answer(worker, frame)
                is_of_now = self._generation == generation and self._runs == run
                # The answer to a picture from before a hijack may be read after the notice of it.
                if report is not None and is_of_now and report.num_hijacks >= self._num_hijacks:
                    self._receive_report(report, frame)
                await asyncio.sleep(max(0.0, interval_s - (time.monotonic() - started_s)))
        finally:
            self._is_ready = False
            worker.kill()  # it keeps nothing, and nobody wants the answer that it may be looking for
            await worker.close()

    async def _answer(self, worker: Worker[PlaceProgram, PlaceEvent], frame: CameraFrame) -> PlaceReport | None:
        """None when this picture could not be looked at; the next one may be better. Raises WorkerDied."""
        try:
            image = ImageFrame(frame.seq, frame.t_robot_ns, frame.exposure_ns, frame.jpeg)
            report = await worker.call(PlaceProgram.answer, image)
        except WorkerDied:
            raise
        except RobotSystemError as exc:
            status = f"a picture could not be looked at: {exc}"
            if self.status != status:
                self._events.notify("place", status, "error")
            self.status = status
            return None
        self.status = "looking"
        return report

    def _on_event(self, event: PlaceEvent) -> None:
        match event:
            case MapReading(fraction, text):
                self._set_status(text, fraction)
            case MapLeftOut(map_id, reason):
                self._events.notify("place", f"the robot is not looked for in {map_id}: {reason}", "error")
            case HijackNotice(hijack, report):
                self._num_hijacks = report.num_hijacks
                if self._report is not None:  # else of another run of the robot, or nothing was known yet
                    self._publish(report)
                self._events.notify("hijack", f"the robot was picked up: {hijack.reason}", "warning")

    def _set_status(self, status: str, progress: float | None) -> None:
        self.status, self.progress = status, progress
        self._events.changed("place")

    def _receive_report(self, report: PlaceReport, frame: CameraFrame) -> None:
        self.answers += 1
        if report.t_evidence_ns is not None:
            self._queries[report.t_evidence_ns] = frame.jpeg
            while len(self._queries) > MAX_QUERY_IMAGES:
                self._queries.popitem(last=False)
        self._publish(report)

    def _publish(self, report: PlaceReport) -> None:
        # The picture may have come before the robot went, and its answer after.
        self._report, self._absent, self._report_s = report, self._gone, time.monotonic()
        self._on_report(report)
        self.visits.add((self.report or report).answer)
        self._events.changed("place")
