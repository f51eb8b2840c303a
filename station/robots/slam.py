"""SLAM of one navigation in a worker; when that dies, another takes its place and knows what comes from then on."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import replace
from pathlib import Path
from typing import Concatenate

from shared.calibration import Calibration
from shared.errors import RobotSystemError
from station.config import SlamConfig, choose_backend
from station.events import Notifier
from station.model.navigation import NavigationReport
from station.model.slam_update import SlamUpdate
from station.workers.request import ArgumentsP, Limit, WorkerDied
from station.workers.slam_interface import SLAM, SlamProgram
from station.workers.worker import Worker

LIVE_BACKENDS = ("ukf", "mono", "smoothing")
DRIVE_BACKLOG = Limit(6000)  # 20 a second: five minutes
DEPTH_BACKLOG = Limit(60)  # four a second: a quarter of a minute, and 60 MB at most
MAX_DEATHS = 5  # a backend that dies again and again costs the machine more than it gives;
QUICK_DEATH_S = 10.0  # one that ran for longer may be killed as often as it likes
HEAD_START_S = 10.0  # somebody waits for its first update
MAX_NOTED_FAILURES = 20  # different sentences; some hold numbers that never repeat


class SlamWorker:
    """Starts the worker, replaces one that dies, hands on its updates. All methods belong on the event loop."""

    def __init__(
        self,
        name: str,
        config: SlamConfig,
        calibration: Calibration,
        events: Notifier,
        on_update: Callable[[SlamUpdate], None],
        on_trouble: Callable[[str], None],
        on_restart: Callable[[], None] = lambda: None,
    ) -> None:
        """`on_trouble` gets a sentence on how SLAM is when no update can say it.

        After `on_restart` everything is in another frame than what came before.
        """
        self._name = name
        self._config = config
        self._calibration = calibration
        self.backend = choose_backend(config.backend, calibration)
        self._events = events
        self._on_update = on_update
        self._on_trouble = on_trouble
        self._on_restart = on_restart
        self._ended = False
        self._report: asyncio.Future[NavigationReport] | None = None  # asked for
        self._deaths = 0  # in a row, each soon after the start
        self._launched_s = 0.0
        self._first_segment = self._segment = 0
        self.restarts = 0
        self._dropped: Counter[Hashable] = Counter()  # by the workers that died
        self._noted: set[str] = set()
        self.failures = 0  # requests that the backend refused
        self.failure = ""  # the first one's sentence
        self.trouble = ""  # why SLAM does not run, or did not until a moment ago; empty while it does
        self._worker, self._starting = self._launch()

    @property
    def pid(self) -> int | None:
        """Of the worker; None while it is being started."""
        return self._worker.pid

    @property
    def frames_dropped(self) -> int:
        """Frames that found a full queue."""
        return self._dropped[SlamProgram.add_frame] + self._worker.dropped.get(SlamProgram.add_frame, 0)

    @property
    def frames_waiting(self) -> int:
        """Frames that SLAM has not looked at yet."""
        return self._worker.waiting(SlamProgram.add_frame)

    def post(
        self,
        method: Callable[Concatenate[SlamProgram, ArgumentsP], None],
        *args: ArgumentsP.args,
        **kwargs: ArgumentsP.kwargs,
    ) -> bool:
        """Hand on sensor data. False when older ones were dropped for them, and not only because SLAM is lost."""
        return self._worker.post(method, *args, **kwargs) or bool(self.trouble)

    async def finish(self, navigation_id: str, folder: Path) -> NavigationReport:
        """End the navigation. Raises what the backend raises, or WorkerDied."""
        self._ended = True  # a process that dies now has nothing to come back for
        await asyncio.wait({self._starting})
        self._report = self._worker.ask(SlamProgram.finish, navigation_id, folder)
        return await self._report

    def give_up(self) -> bool:
        """End the process in the middle of its work: `finish` raises WorkerDied then. False: it had ended by itself."""
        if self._report is not None and self._report.done():
            return False
        self._ended = True
        self._worker.kill()
        return True

    async def close(self, *, at_once: bool = False) -> None:
        """End the process, also one that is just being started; `at_once`: in the middle of its work."""
        self._ended = True
        if at_once:
            self._worker.kill()
        await self._worker.close()
        await asyncio.wait({self._starting})

    def _launch(self) -> tuple[Worker[SlamProgram, SlamUpdate], asyncio.Task[None]]:
        config = self._config
        frames = Limit(config.frame_backlog, config.frame_wait_s)
        if self.backend in LIVE_BACKENDS:  # an offline backend may be behind, a live one may not
            frames = Limit(config.live_frame_backlog, config.live_frame_wait_s)
        self._launched_s = time.monotonic()
        worker = Worker(
            self._name,
            SLAM,
            limits={
                SlamProgram.add_frame: frames,
                SlamProgram.add_imu: Limit(config.imu_backlog),
                SlamProgram.add_drive: DRIVE_BACKLOG,
                SlamProgram.add_depth: DEPTH_BACKLOG,
            },
            head_start_s=HEAD_START_S,
            on_event=self._receive,
            on_death=self._on_death,
            on_failure=self._on_failure,
        )
        # Asked before the first frame can come; what arrives until SLAM is up waits behind it.
        begun = worker.ask(SlamProgram.begin, self.backend, self._calibration, config.seed)
        return worker, asyncio.create_task(self._start(worker, begun), name=f"start {self._name}")

    async def _start(self, worker: Worker[SlamProgram, SlamUpdate], begun: asyncio.Future[None]) -> None:
        try:
            await worker.start()
            await begun
            self.trouble = ""
        except WorkerDied:
            pass  # _on_death notifies of it, unless we closed it
        except (RobotSystemError, OSError) as exc:
            # The recording goes on: a navigation without live SLAM is better than none.
            begun.cancel()
            self._report_trouble("slam", f"SLAM does not run: {exc}")

    def _on_death(self, reason: str) -> None:
        self.trouble = reason
        if self._ended:
            return
        if time.monotonic() - self._launched_s > QUICK_DEATH_S:
            self._deaths = 0
        self._deaths += 1
        if self._deaths >= MAX_DEATHS:
            self._report_trouble(
                "worker", f"{reason}; SLAM died {self._deaths} times, the recording goes on without it"
            )
            return
        self._on_trouble("SLAM was lost; the recording goes on")
        self._events.notify("worker", f"{reason}; it is started again, the part before is lost to SLAM", "error")
        self._dropped.update(self._worker.dropped)
        self.restarts += 1
        self._first_segment = self._segment + 1
        self._on_restart()
        self._worker, self._starting = self._launch()

    def _receive(self, update: SlamUpdate) -> None:
        """A new worker counts its segments from 0 again, and its world is another one."""
        if self._first_segment:
            update = replace(update, segment=update.segment + self._first_segment)
        self._segment = max(self._segment, update.segment)
        self._on_update(update)

    def _on_failure(self, sentence: str) -> None:
        self.failures += 1
        self.failure = self.failure or sentence
        if sentence not in self._noted and len(self._noted) < MAX_NOTED_FAILURES:
            self._noted.add(sentence)
            self._events.notify("slam", f"SLAM refused what it was given: {sentence}", "warning")

    def _report_trouble(self, topic: str, sentence: str) -> None:
        self.trouble = sentence
        self._on_trouble(sentence)
        self._events.notify(topic, sentence, "error")
