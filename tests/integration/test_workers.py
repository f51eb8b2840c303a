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

from station.workers.worker import NICE, Worker, WorkerDied, WorkerFailed

SERVANT = "tests.integration.test_workers:Servant"


class Servant:
    """What runs in the process."""

    def __init__(self, emit: Callable[[Any], None]) -> None:
        self._emit = emit

    def nice(self) -> int:
        return os.nice(0)

    def say(self, what: object) -> None:
        self._emit(what)

    def back(self, data: bytes) -> bytes:
        return data[::-1]

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def leave_a_child(self, seconds: float) -> int:
        """Its copy of the pipe keeps that open."""
        child = os.fork()
        if not child:
            time.sleep(seconds)
            os._exit(0)
        return child


@asynccontextmanager
async def started(**options: Any) -> AsyncIterator[Worker]:
    worker = Worker("test", SERVANT, **options)
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
        assert await worker.call("back", data) == data[::-1]


async def test_no_thread_moves_the_bytes() -> None:
    async with started() as worker:
        await worker.call("back", b"")
        assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("test")]


async def test_a_worker_is_as_important_as_the_station_until_its_first_event() -> None:
    base = os.nice(0)
    async with started(head_start_s=1000.0) as worker:
        assert await worker.call("nice") == base
        await worker.call("say", "here I am")
        assert await worker.call("nice") == base + NICE
    async with started() as worker:
        assert await worker.call("nice") == base + NICE


async def test_events_come_in_order_before_the_answer() -> None:
    heard: list[int] = []
    async with started(on_event=heard.append) as worker:
        for n in range(500):
            worker.post("say", n)
        await worker.call("nice")
        assert heard == list(range(500))


async def test_an_event_that_cannot_be_taken_does_not_cost_the_worker() -> None:
    heard: list[int] = []

    def take(event: int) -> None:
        heard.append(event)
        if event == 1:
            raise ValueError("nobody can take this")

    async with started(on_event=take) as worker:
        for event in range(3):
            worker.post("say", event)
        assert await worker.call("back", b"ab") == b"ba"
        assert heard == [0, 1, 2]


async def test_what_a_busy_worker_has_not_taken_may_still_be_dropped() -> None:
    async with started(limits={"frame": 5}) as worker:
        worker.post("sleep", 1.0)
        kept = [worker.post("back", bytes(200_000), kind="frame") for _ in range(50)]
        assert kept.count(False) >= 40  # the rest is in the system's buffers
        await worker.call("nice")
        assert worker.dropped["frame"] == kept.count(False) and worker.waiting("frame") == 0


async def test_what_cannot_be_sent_is_told_to_who_asks_and_the_next_is_sent() -> None:
    async with started() as worker:
        with pytest.raises(WorkerFailed, match="cannot be sent"):
            await worker.call("back", lambda: None)
        assert await worker.call("back", b"ab") == b"ba"


async def test_a_killed_worker_fails_who_waits_and_is_told_once() -> None:
    deaths: list[str] = []
    async with started(on_death=deaths.append) as worker:
        waiting = worker.ask("sleep", 100.0)
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)
        with pytest.raises(WorkerDied, match="exit code -9"):
            await waiting
        assert len(deaths) == 1 and "ended unexpectedly" in deaths[0]
        assert not worker.post("nice")


async def test_closing_does_not_wait_for_what_the_worker_left_behind() -> None:
    async with started() as worker:
        child = await worker.call("leave_a_child", 100.0)
    os.kill(child, signal.SIGKILL)  # it is there still


async def test_one_that_is_cancelled_while_it_starts_leaves_no_process() -> None:
    worker = Worker("test", SERVANT)
    starting = asyncio.create_task(worker.start())
    await until(lambda: worker.pid is not None)
    starting.cancel()
    await asyncio.gather(starting, return_exceptions=True)
    await worker.close()
    pid = worker.pid
    assert pid is not None
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
