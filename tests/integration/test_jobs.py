"""Background jobs whose process, executor or files fail: each ends, and says why in a sentence."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from shared.errors import DataError
from station.errors import Conflict
from station.events import Events
from station.workers.executors.opening import open_executor
from station.workers.jobs import Job, Jobs, JobWorker
from station.workers.library_interface import Progress
from station.workers.request import Program, ProgramName, WorkerDied
from station.workers.worker import Worker

STARTS_WITHIN_S = 120.0  # the first process of all waits for its server's imports


def double(number: int) -> int:
    return 2 * number


class Porter(Program):
    """What the workers of jobs run."""

    def __init__(self, emit: Callable[[Progress], None]) -> None:
        self.emit = emit

    def wait(self) -> None:
        self.emit(Progress(0.5, str(os.getpid())))
        time.sleep(600)

    def double(self) -> list[int]:
        with open_executor("processes") as machines:
            return machines.map(double, [1, 2, 3])


async def until(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + STARTS_WITHIN_S
    while not condition():
        assert time.monotonic() < deadline_s, "the awaited condition did not come true"
        await asyncio.sleep(0.02)


async def run(jobs: Jobs[Porter], work: Callable[[JobWorker[Porter]], Awaitable[dict[str, Any]]]) -> Job:
    """A job until it is over, once the processes of earlier ones have ended."""
    await until(lambda: not jobs._running)
    job = jobs.start("test", "a test", work)
    await until(lambda: jobs.get(job.id).state != "running")
    return jobs.get(job.id)


async def test_a_job_that_fails_in_any_way_says_so_and_leaves_room_for_the_next() -> None:
    events = Events()
    jobs = Jobs(events, ProgramName.of(Porter))

    async def waiting(worker: JobWorker[Porter]) -> dict[str, Any]:
        await worker.call(Porter.wait)
        return {}

    async def failing(worker: JobWorker[Porter]) -> dict[str, Any]:
        raise DataError("the drive cannot be read")

    async def stumbling(worker: JobWorker[Porter]) -> dict[str, Any]:
        raise OSError(28, "No space left on device")

    async def doubling(worker: JobWorker[Porter]) -> dict[str, Any]:
        return {"doubled": await worker.call(Porter.double)}

    try:
        killed = jobs.start("test", "a test", waiting)
        queued = jobs.start("test", "another test", waiting)
        await until(lambda: jobs.get(killed.id).progress and jobs.get(queued.id).progress)
        os.kill(int(jobs.get(killed.id).message), signal.SIGKILL)
        await until(lambda: jobs.get(killed.id).state == "failed")
        assert "ended unexpectedly" in jobs.get(killed.id).message
        assert jobs.get(queued.id).state == "running"  # it has a process of its own
        assert (await jobs.cancel(queued.id)).state == "cancelled"
        assert (await run(jobs, failing)).message == "the drive cannot be read"
        stumbled = await run(jobs, stumbling)
        assert stumbled.state == "failed" and "No space left" in stumbled.message
        assert sum(line.level == "error" for line in events.log) == 3
        done = await run(jobs, doubling)
        assert done.result == {"doubled": [2, 4, 6]}, done.message
        await until(lambda: not jobs._running)
        with pytest.raises(Conflict, match="a test: done; there is nothing left to cancel"):
            await jobs.cancel(done.id)
    finally:
        await jobs.close()


@pytest.mark.parametrize("awaited", [0, 1])
async def test_a_second_worker_works_beside_the_first_and_both_end_when_the_job_is_cancelled(awaited: int) -> None:
    jobs = Jobs(Events(), ProgramName.of(Porter))
    workers: list[JobWorker[Porter]] = []

    async def both(worker: JobWorker[Porter]) -> dict[str, Any]:
        async with jobs.beside(worker) as second:
            workers.extend([worker, second])
            assert await second.call(Porter.double) == [2, 4, 6]
            workers[1 - awaited].post(Porter.wait)
            await workers[awaited].call(Porter.wait)
        raise AssertionError("it was cancelled")

    try:
        job = jobs.start("test", "a test", both)
        await until(lambda: jobs.get(job.id).progress)
        assert (await jobs.cancel(job.id)).state == "cancelled"
        assert workers[0].pid != workers[1].pid and all(worker.is_ended for worker in workers)
        for worker in workers:
            assert not Path(f"/proc/{worker.pid}").exists()
    finally:
        await jobs.close()


async def test_a_job_goes_on_where_the_system_has_no_second_process(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = Jobs(Events(), ProgramName.of(Porter))

    async def refuse(_: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    async def both(worker: JobWorker[Porter]) -> dict[str, Any]:
        monkeypatch.setattr(Worker, "start", refuse)
        async with jobs.beside(worker) as second:
            second.post(Porter.double)
            with pytest.raises(WorkerDied):
                await second.call(Porter.double)
            return {"doubled": await worker.call(Porter.double)}

    try:
        assert (await run(jobs, both)).result == {"doubled": [2, 4, 6]}
    finally:
        await jobs.close()


async def test_a_job_that_was_done_before_it_could_be_cancelled_is_not_called_cancelled() -> None:
    """Its process has answered; what is left is a line in the station's own files."""
    jobs = Jobs(Events(), ProgramName.of(Porter))
    may_write = asyncio.Event()

    async def writing(worker: JobWorker[Porter]) -> dict[str, Any]:
        doubled = await worker.call(Porter.double)
        answered.set()
        await may_write.wait()
        return {"doubled": doubled}

    answered = asyncio.Event()
    try:
        job = jobs.start("test", "a test", writing)
        await answered.wait()
        cancelling = asyncio.create_task(jobs.cancel(job.id))
        asyncio.get_running_loop().call_later(0.01, may_write.set)
        with pytest.raises(Conflict, match="nothing left to cancel"):
            await cancelling
        assert jobs.get(job.id).state == "done"
    finally:
        await jobs.close()


async def test_a_job_whose_process_cannot_be_made_fails_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(_: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    async def work(_: JobWorker[Porter]) -> dict[str, Any]:
        raise AssertionError("there is no worker to work with")

    monkeypatch.setattr(Worker, "start", refuse)
    jobs, heard = Jobs(Events(), ProgramName.of(Porter)), list[str]()
    job = jobs.start("carry", "a box", work, on_failure=heard.append)
    await until(lambda: jobs.get(job.id).state == "failed")
    assert len(heard) == 1 and "temporarily unavailable" in heard[0]
