"""Work in the background, each job with a worker of its own: its progress is seen, and it can be cancelled."""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal

from shared.bounded import shown
from shared.errors import RobotSystemError
from station.errors import Conflict, Unknown
from station.events import Notifier
from station.workers.library_interface import Progress
from station.workers.request import ProgramName, ProgramT
from station.workers.worker import Worker

logger = logging.getLogger(__name__)

MAX_STORED_JOBS = 50
MAX_RUNNING_JOBS = 2  # a job loads a core, and a second one for a while; more at once would slow SLAM and localisation
JobWorker = Worker[ProgramT, Progress]
JobState = Literal["running", "done", "failed", "cancelled"]


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of work and how far it is."""

    id: str
    kind: str  # "build map"
    title: str
    state: JobState = "running"
    progress: float = 0.0  # 0..1
    message: str = "starting"
    result: dict[str, Any] | None = None  # of a job that is done


class Jobs(Generic[ProgramT]):
    """All jobs since the station started, newest last."""

    def __init__(self, events: Notifier, program: ProgramName[ProgramT, Progress]) -> None:
        """`program` is what the worker of each job runs."""
        self._events = events
        self._program = program
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._running: dict[str, tuple[asyncio.Task[None], list[JobWorker[ProgramT]]]] = {}
        self._cancelled: set[str] = set()  # those of them that somebody cancelled
        self._count = 0

    def list(self) -> list[Job]:
        return list(self._jobs.values())

    def get(self, job_id: str) -> Job:
        """Raises Unknown."""
        if job_id not in self._jobs:
            raise Unknown(f"there is no job {shown(job_id)}; GET /jobs lists them")
        return self._jobs[job_id]

    def start(
        self,
        kind: str,
        title: str,
        work: Callable[[JobWorker[ProgramT]], Awaitable[dict[str, Any]]],
        on_failure: Callable[[str], None] = lambda _: None,
    ) -> Job:
        """Run `work` with a fresh worker. Raises Conflict when enough jobs run.

        `on_failure` hears in a sentence why the job came to nothing, also where `work` was never begun.
        """
        self.require_room()
        self._count += 1
        job = Job(id=f"job-{self._count}", kind=kind, title=title)
        worker = Worker(job.id, self._program, on_event=lambda progress: self._advance(job.id, progress))
        self._store(job)
        task = asyncio.create_task(self._run(job.id, worker, work, on_failure), name=job.id)
        self._running[job.id] = (task, [worker])
        return job

    def require_room(self) -> None:
        """Raises Conflict when enough jobs run."""
        if len(self._running) >= MAX_RUNNING_JOBS:
            raise Conflict(f"{MAX_RUNNING_JOBS} jobs run already; wait for one or cancel it with DELETE /jobs/{{id}}")

    @asynccontextmanager
    async def beside(self, worker: JobWorker[ProgramT]) -> AsyncIterator[JobWorker[ProgramT]]:
        """A second worker for what a job can do at the same time; ends with the block, at once where that fails.

        Whoever cancels the job ends it, too. Where there can be none, what it is asked fails as if it had died.
        """
        second = Worker(worker.name, self._program, on_event=lambda progress: self._advance(worker.name, progress))
        _, workers = self._running[worker.name]
        workers.append(second)
        try:
            try:
                await second.start()
            except OSError as exc:
                logger.warning("no second process for %s (%s)", worker.name, exc)
                second.kill()
            yield second
        except BaseException:
            second.kill()
            raise
        finally:
            workers.remove(second)
            await second.close()

    async def cancel(self, job_id: str) -> Job:
        """End a running job. Raises Unknown; Conflict for one that was over before it could be cancelled."""
        job = self.get(job_id)
        if job.state == "running":
            await self._end(job_id)
            job = self.get(job_id)
        if job.state != "cancelled":
            raise Conflict(f"{job.title}: {job.message}; there is nothing left to cancel")
        return job

    async def close(self) -> None:
        for job_id in list(self._running):
            await self._end(job_id)

    async def _end(self, job_id: str) -> None:
        task, workers = self._running[job_id]
        self._cancelled.add(job_id)
        for worker in workers:
            worker.kill()
        await asyncio.wait([task])

    async def _run(
        self,
        job_id: str,
        worker: JobWorker[ProgramT],
        work: Callable[[JobWorker[ProgramT]], Awaitable[dict[str, Any]]],
        on_failure: Callable[[str], None],
    ) -> None:
        try:
            await worker.start()
            result = await work(worker)
            done = replace(self._jobs[job_id], state="done", progress=1.0, message="done", result=result)
            self._store(done)
            self._events.notify("job", f"{done.title}: done")
        except RobotSystemError as exc:
            on_failure(str(exc))
            self._fail(job_id, str(exc))
        except Exception as exc:  # on top of the job: whatever it is, nobody must wait for what will never be done
            logger.exception("%s", job_id)
            sentence = f"an error of the station ended this job: {exc!r}"
            on_failure(sentence)
            self._fail(job_id, sentence)
        finally:
            await worker.close()
            self._running.pop(job_id, None)
            self._cancelled.discard(job_id)

    def _fail(self, job_id: str, sentence: str) -> None:
        job = self._jobs[job_id]
        if job_id in self._cancelled:
            self._store(replace(job, state="cancelled", message="cancelled"))
        else:
            self._store(replace(job, state="failed", message=sentence))
            self._events.notify("job", f"{job.title}: {sentence}", "error")

    def _advance(self, job_id: str, progress: Progress) -> None:
        job = self._jobs[job_id]
        if job.state == "running":
            self._store(replace(job, progress=progress.fraction, message=progress.message))

    def _store(self, job: Job) -> None:
        self._jobs[job.id] = job
        self._events.changed("job", job, job.id)
        for old in list(self._jobs):
            if len(self._jobs) > MAX_STORED_JOBS and self._jobs[old].state != "running":
                del self._jobs[old]
                self._events.forget("job", old)
