"""Worker processes, from the station's end. Each runs one program; what it is asked goes over a pipe.

Requests wait in a bounded outbox; two tasks of the event loop move the bytes: threads would have to take turns with it.
An exception in the program is raised at the caller. A process that dies fails what waits for it and is reported once.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import pickle
import socket
from collections.abc import Callable, Hashable, Mapping
from multiprocessing import forkserver
from typing import Any, Concatenate, Generic, TypeVar

from station.workers.child import LENGTH, Asked, Reply, run_worker
from station.workers.outbox import Outbox
from station.workers.request import (
    ArgumentsP,
    EventT,
    Limit,
    Method,
    ProgramName,
    ProgramT,
    WorkerDied,
    WorkerFailed,
)

logger = logging.getLogger(__name__)

AnswerT = TypeVar("AnswerT")
END_TIMEOUT_S = 1.5
MAX_CALLS = 1_000  # calls wait for an answer, so none is dropped: a further one is refused
# Forking the station would copy threads' locks and the event loop; spawning means seconds of imports per worker, and
# memory for them. So workers are forked from a server process that has done the imports and nothing else.
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["station.workers.preload"])


def warm_up() -> None:
    """Start the server process, so that the first worker need not wait for its imports. Returns at once."""
    forkserver.ensure_running()


class Worker(Generic[ProgramT, EventT]):
    """One worker process and the way to talk to it. All methods belong on the event loop."""

    def __init__(
        self,
        name: str,
        program: ProgramName[ProgramT, EventT],
        *,
        limits: Mapping[Method, Limit] | None = None,
        head_start_s: float = 0.0,
        on_event: Callable[[EventT], None] | None = None,
        on_death: Callable[[str], None] | None = None,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        """`limits` are for requests, by their method, that nobody waits for.

        Until its first event, at most for `head_start_s`, it runs as important as the station itself: a dead worker is
        soon replaced, however busy the others are.
        `on_failure` hears in a sentence what a posted request or `catch_up` raised: nobody waits for an answer.
        """
        self.name = name
        self._program = program
        self._limits = dict(limits or {})
        self._head_start_s = head_start_s
        self._outbox: Outbox[bytes] = Outbox()  # packed: inertial samples that wait are ten times as large as lists
        self._on_event = on_event
        self._on_death = on_death
        self._on_failure = on_failure
        self._calls: dict[int, asyncio.Future[Any]] = {}
        self._next_call = 0
        self._process: Any = None
        self._spawning: asyncio.Future[None] | None = None
        self._moving: tuple[asyncio.Task[None], ...] = ()  # what moves the bytes
        self._closing = False
        self._dead = ""

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    @property
    def is_ended(self) -> bool:
        """Whether its process was told to end, or was killed, by us."""
        return self._closing

    @property
    def dropped(self) -> Mapping[Hashable, int]:
        """How many posted requests found the outbox full, by their method."""
        return self._outbox.dropped

    def waiting(self, method: Method) -> int:
        """How many posted requests wait to be sent."""
        return self._outbox.waiting(method)

    async def start(self) -> None:
        """Start the process; requests may be posted from now on, it answers when it is up."""
        ours, theirs = socket.socketpair()
        self._spawning = asyncio.ensure_future(asyncio.to_thread(self._spawn, theirs))
        try:
            await asyncio.shield(self._spawning)  # whoever is cancelled here: `close` finds the process
            reader, writer = await asyncio.open_connection(sock=ours)
        except BaseException:
            ours.close()  # the process ends when nobody talks to it
            raise
        # What is not sent yet waits in the outbox, where it may be dropped.
        writer.transport.set_write_buffer_limits(high=0)
        self._moving = (
            asyncio.create_task(self._write(writer), name=f"{self.name} requests"),
            asyncio.create_task(self._read(reader, writer), name=f"{self.name} answers"),
        )

    def post(
        self,
        method: Callable[Concatenate[ProgramT, ArgumentsP], object],
        *args: ArgumentsP.args,
        **kwargs: ArgumentsP.kwargs,
    ) -> bool:
        """Ask without waiting for an answer. False when an older request for this method was dropped for it."""
        if self._dead or self._closing:
            return False
        return self._put(method, Asked(None, method.__name__, args, kwargs), self._limits.get(method, Limit()))

    async def call(
        self,
        method: Callable[Concatenate[ProgramT, ArgumentsP], AnswerT],
        *args: ArgumentsP.args,
        **kwargs: ArgumentsP.kwargs,
    ) -> AnswerT:
        """Ask, and wait for the answer. Raises what the program raised, or WorkerDied."""
        return await self.ask(method, *args, **kwargs)

    def ask(
        self,
        method: Callable[Concatenate[ProgramT, ArgumentsP], AnswerT],
        *args: ArgumentsP.args,
        **kwargs: ArgumentsP.kwargs,
    ) -> asyncio.Future[AnswerT]:
        """As `call`, and the request stands in line already when this returns: what is posted later comes later."""
        future: asyncio.Future[AnswerT] = asyncio.get_running_loop().create_future()
        if self._dead or self._closing:
            future.set_exception(WorkerDied(self._dead or f"the {self.name} worker is ending"))
            return future
        if len(self._calls) >= MAX_CALLS:
            future.set_exception(WorkerFailed(f"{MAX_CALLS} calls wait for the {self.name} worker already"))
            return future
        self._next_call += 1
        number = self._next_call
        self._calls[number] = future
        future.add_done_callback(lambda _: self._calls.pop(number, None))
        self._put("call", Asked(number, method.__name__, args, kwargs), Limit())
        return future

    def kill(self) -> None:
        """End the process at once, whatever it computes."""
        self._closing = True
        self._outbox.close()
        if self._process is not None and self._process.pid is not None and self._process.is_alive():
            self._process.kill()
        self._fail_calls(f"the {self.name} worker was stopped")

    async def close(self) -> None:
        """Let the process end after its present request; kill it when that takes long."""
        if not self._closing and not self._dead:
            # No SIGTERM: libraries in there install handlers that print stack traces.
            self._put("end", Asked(None, "", (), {}), Limit())
        self._closing = True
        if self._spawning is not None:
            await asyncio.wait({self._spawning})
        if self._process is None or self._process.pid is None:  # never started, or the system had no process for it
            self._outbox.close()
            self._fail_calls(f"the {self.name} worker was stopped")
            return
        await asyncio.to_thread(self._process.join, END_TIMEOUT_S)
        if self._process.is_alive():
            self._process.kill()
            await asyncio.to_thread(self._process.join, END_TIMEOUT_S)
        self._outbox.close()
        for task in self._moving:  # a process of the worker's own may hold the pipe open
            task.cancel()
        await asyncio.gather(*self._moving, return_exceptions=True)
        self._fail_calls(f"the {self.name} worker was stopped")

    def _spawn(self, theirs: socket.socket) -> None:
        with theirs:  # the process has its own copy; ours would keep it open when that has ended
            self._process = _CONTEXT.Process(
                target=run_worker,
                args=(theirs, self.name, self._head_start_s, self._program),
                name=self.name,
                daemon=True,
            )
            self._process.start()

    def _put(self, kind: Hashable, asked: Asked, limit: Limit) -> bool:
        """False when an older one was dropped for it. One that cannot be sent fails as if the program had raised."""
        try:
            data = pickle.dumps(asked, pickle.HIGHEST_PROTOCOL)
        except Exception as exc:  # pickling runs the code of what it is given
            self._receive(Reply(asked.call, False, WorkerFailed(f"{asked.method} cannot be sent: {exc}")))
            return True
        return self._outbox.put(kind, data, limit)

    async def _write(self, writer: asyncio.StreamWriter) -> None:
        while (data := await self._outbox.get()) is not None:
            try:
                writer.write(LENGTH.pack(len(data)) + data)  # some Pythons' `writelines` never make `drain` wait
                await writer.drain()
            except OSError:
                return  # the reader notices the end and reports it

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                (length,) = LENGTH.unpack(await reader.readexactly(LENGTH.size))
                reply = pickle.loads(await reader.readexactly(length))  # from our own child  # noqa: S301  # nosec B301
                self._receive(reply)
        except (asyncio.IncompleteReadError, OSError):
            await asyncio.to_thread(self._process.join, END_TIMEOUT_S)
            self._end()
        finally:
            writer.close()

    def _receive(self, reply: Reply) -> None:
        try:
            self._deliver(reply)
        except Exception:  # on top of what others do with an event: it must not cost the worker
            logger.exception("%s worker: what it sent could not be delivered", self.name)

    def _deliver(self, reply: Reply) -> None:
        if reply.call is None:
            if not reply.is_ok:
                logger.error("%s worker: %s", self.name, reply.value)
                if self._on_failure is not None:
                    self._on_failure(str(reply.value))
            elif self._on_event is not None:
                self._on_event(reply.value)
            return
        future = self._calls.get(reply.call)
        if future is None or future.done():
            return
        if reply.is_ok:
            future.set_result(reply.value)
        else:
            future.set_exception(reply.value)

    def _end(self) -> None:
        if self._closing or self._dead:
            return
        code = self._process.exitcode
        self._dead = f"the {self.name} worker ended unexpectedly (exit code {code})"
        self._outbox.close()
        logger.error("%s", self._dead)
        self._fail_calls(self._dead)
        if self._on_death is not None:
            self._on_death(self._dead)

    def _fail_calls(self, reason: str) -> None:
        for future in list(self._calls.values()):
            if not future.done():
                future.set_exception(WorkerDied(reason))
