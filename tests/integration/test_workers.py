"""Worker processes over their pipe: what is asked is answered, what dies is told, and nothing is left behind."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from station.workers.child import NICE
from station.workers.request import Limit, Program, ProgramName, WorkerDied, WorkerFailed
from station.workers.worker import Worker


class Puppet(Program):
    """What runs in the process: it does what the requests want."""

    def __init__(self, emit: Callable[[Any], None]) -> None:
        self._emit = emit
        self._idle: list[str] = []

    def leave_for_later(self, *work: str) -> None:
        self._idle += work

    def catch_up(self) -> bool:
        if not self._idle:
            return False
        work = self._idle.pop(0)
        if work == "stumble":
            self.stumble()
        self._emit(work)
        return True

    def niceness(self) -> int:
        return os.nice(0)

    def emit(self, event: object) -> None:
        self._emit(event)

    def reverse(self, data: bytes) -> bytes:
        return data[::-1]

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def leave_child(self, seconds: float) -> int:
        """Its copy of the pipe keeps that open."""
        child = os.fork()
        if not child:
            time.sleep(seconds)
            os._exit(0)
        return child

    def stumble(self) -> None:
        raise ZeroDivisionError("a bug")


PUPPET = ProgramName.of(Puppet)


@asynccontextmanager
async def started(**options: Any) -> AsyncIterator[Worker[Puppet, Any]]:
    worker = Worker("test", PUPPET, **options)
    await worker.start()
    try:
        yield worker
    finally:
        await worker.close()


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.01)


async def test_large_requests_and_answers_come_whole() -> None:
    data = os.urandom(16 * 2**20)
    async with started() as worker:
        assert await worker.call(Puppet.reverse, data) == data[::-1]


async def test_no_thread_moves_the_bytes() -> None:
    async with started() as worker:
        await worker.call(Puppet.reverse, b"")
        assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("test")]


async def test_a_worker_is_as_important_as_the_station_until_its_first_event() -> None:
    base = os.nice(0)
    least = min(base + NICE, 19)  # the kernel's last
    async with started(head_start_s=1000.0) as worker:
        assert await worker.call(Puppet.niceness) == base
        await worker.call(Puppet.emit, "here I am")
        assert await worker.call(Puppet.niceness) == least
    async with started() as worker:
        assert await worker.call(Puppet.niceness) == least


async def test_events_come_in_order_before_the_answer() -> None:
    heard: list[int] = []
    async with started(on_event=heard.append) as worker:
        for n in range(500):
            worker.post(Puppet.emit, n)
        await worker.call(Puppet.niceness)
        assert heard == list(range(500))


async def test_an_event_that_cannot_be_delivered_does_not_cost_the_worker() -> None:
    heard: list[int] = []

    def receive(event: int) -> None:
        heard.append(event)
        if event == 1:
            raise ValueError("nobody can use this")

    async with started(on_event=receive) as worker:
        for event in range(3):
            worker.post(Puppet.emit, event)
        assert await worker.call(Puppet.reverse, b"ab") == b"ba"
        assert heard == [0, 1, 2]


async def test_what_a_busy_worker_has_not_taken_may_still_be_dropped() -> None:
    async with started(limits={Puppet.reverse: Limit(5)}) as worker:
        worker.post(Puppet.sleep, 1.0)
        kept = [worker.post(Puppet.reverse, bytes(200_000)) for _ in range(50)]
        assert kept.count(False) >= 40  # the rest is in the system's buffers
        await worker.call(Puppet.niceness)
        assert worker.dropped[Puppet.reverse] == kept.count(False) and worker.waiting(Puppet.reverse) == 0


async def test_what_waits_is_packed_already() -> None:
    heard: list[list[float]] = []
    async with started(on_event=heard.append) as worker:
        sample = [0.5, 1.5]
        worker.post(Puppet.emit, sample)
        sample.append(2.5)
        await worker.call(Puppet.niceness)
    assert heard == [[0.5, 1.5]]


async def test_what_cannot_be_sent_is_told_to_who_asks_and_the_next_is_sent() -> None:
    async with started() as worker:
        with pytest.raises(WorkerFailed, match="cannot be sent"):
            await worker.call(Puppet.emit, lambda: None)
        assert await worker.call(Puppet.reverse, b"ab") == b"ba"


async def test_a_bug_is_raised_at_who_asks_and_said_of_what_was_posted() -> None:
    failures: list[str] = []
    async with started(on_failure=failures.append) as worker:
        with pytest.raises(WorkerFailed, match="stumble failed: ZeroDivisionError: a bug"):
            await worker.call(Puppet.stumble)
        worker.post(Puppet.stumble)
        await worker.call(Puppet.niceness)
    assert failures == ["stumble failed: ZeroDivisionError: a bug"]


async def test_a_bug_in_work_that_could_wait_is_said_and_the_work_after_it_is_done() -> None:
    failures: list[str] = []
    heard: list[str] = []
    async with started(on_failure=failures.append, on_event=heard.append) as worker:
        await worker.call(Puppet.leave_for_later, "before", "stumble", "after")
        await until(lambda: len(failures) == 1)
        assert heard == ["before"]
        await worker.call(Puppet.niceness)
        await until(lambda: heard == ["before", "after"])
    assert failures == ["work that could wait failed: ZeroDivisionError: a bug"]


async def test_work_that_could_wait_and_fails_again_and_again_is_told_once() -> None:
    failures: list[str] = []
    async with started(on_failure=failures.append) as worker:
        await worker.call(Puppet.leave_for_later, "stumble", "stumble", "stumble")
        await until(lambda: len(failures) == 1)  # it comes when no request does
        for _ in range(4):
            await worker.call(Puppet.niceness)
            await asyncio.sleep(0.02)
    assert failures == ["work that could wait failed: ZeroDivisionError: a bug"]


async def test_calls_beyond_what_can_wait_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.workers.worker.MAX_CALLS", 1)
    worker = Worker("test", PUPPET)
    waiting = worker.ask(Puppet.niceness)
    with pytest.raises(WorkerFailed, match="1 calls wait"):
        await worker.call(Puppet.niceness)
    await worker.close()  # never started: nothing to wait for
    with pytest.raises(WorkerDied):
        await waiting


async def test_a_killed_worker_fails_who_waits_and_is_told_once() -> None:
    deaths: list[str] = []
    async with started(on_death=deaths.append) as worker:
        waiting = worker.ask(Puppet.sleep, 100.0)
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)
        with pytest.raises(WorkerDied, match="exit code -9"):
            await waiting
        assert len(deaths) == 1 and "ended unexpectedly" in deaths[0]
        assert not worker.post(Puppet.niceness)


async def test_closing_does_not_wait_for_what_the_worker_left_behind() -> None:
    async with started() as worker:
        child = await worker.call(Puppet.leave_child, 100.0)
    os.kill(child, signal.SIGKILL)  # it is there still


async def test_one_that_is_cancelled_while_it_starts_leaves_no_process() -> None:
    worker = Worker("test", PUPPET)
    starting = asyncio.create_task(worker.start())
    await until(lambda: worker.pid is not None)
    starting.cancel()
    await asyncio.gather(starting, return_exceptions=True)
    await worker.close()
    pid = worker.pid
    assert pid is not None
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
