"""Worker processes. Each owns one servant object; the station calls its methods by name over a pipe.

Requests wait in a bounded outbox; two tasks of the event loop move the bytes: threads would have to take turns with it.
An exception in the servant is raised at the caller. A process that dies fails what waits for it and is reported once.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import math
import multiprocessing
import os
import pickle
import select
import signal
import socket
import struct
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

from shared.errors import RobotSystemError

logger = logging.getLogger(__name__)

END_TIMEOUT_S = 1.5
MAX_WAITING = 10_000  # requests of one kind that nobody gave a limit: then the oldest is dropped, counted
MAX_CALLS = 1_000  # calls wait for an answer, so none is dropped: a further one is refused
END = "<end>"  # the request that ends a worker
LENGTH = struct.Struct("!Q")  # before each pickled request, answer or event
# Forking the station would copy threads' locks and the event loop; spawning means seconds of imports per worker, and
# memory for them. So workers are forked from a server process that has done the imports and nothing else.
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["station.workers.preload"])
NICE = 10  # the event loop comes first: it gets nine times the share of any worker, and there may be twenty busy ones


class WorkerDied(RobotSystemError):
    """The worker process ended while it was needed."""


class WorkerFailed(RobotSystemError):
    """The worker raised something that is not one of our errors: a bug."""


def warm_up() -> None:
    """Start the server process, so that the first worker need not wait for its imports. Returns at once."""
    forkserver.ensure_running()


class Outbox:
    """Requests on their way to a worker, oldest first. When a kind is full its oldest is dropped and counted.

    What waits longer than its kind may is dropped too, when the next one of its kind comes.
    """

    def __init__(
        self,
        limits: Mapping[str, int],
        max_age_s: Mapping[str, float] | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limits = dict(limits)
        self._max_age_s = dict(max_age_s or {})
        self._now_s = now_s
        self._queues: dict[str, deque[tuple[int, float, tuple[Any, ...]]]] = defaultdict(deque)  # number, when it came
        self._count = 0
        self._changed = asyncio.Event()  # something waits, or nothing will any more
        self._closed = False
        self.dropped: Counter[str] = Counter()

    def put(self, kind: str, item: tuple[Any, ...]) -> bool:
        """Add an item; False when older ones of its kind had to go."""
        now_s = self._now_s()
        queue = self._queues[kind]
        limit, max_age_s = self._limits.get(kind, MAX_WAITING), self._max_age_s.get(kind, math.inf)
        dropped = 0
        while queue and (len(queue) >= limit or now_s - queue[0][1] > max_age_s):
            queue.popleft()
            dropped += 1
        self.dropped[kind] += dropped
        self._count += 1
        queue.append((self._count, now_s, item))
        self._changed.set()
        return not dropped

    async def take(self) -> tuple[Any, ...] | None:
        """Wait for the next item; None when the outbox is closed."""
        while not self._closed:
            if waiting := [queue for queue in self._queues.values() if queue]:
                return min(waiting, key=lambda queue: queue[0][0]).popleft()[2]
            self._changed.clear()
            await self._changed.wait()
        return None

    def waiting(self, kind: str) -> int:
        """How many items of a kind wait."""
        return len(self._queues[kind])

    def close(self) -> None:
        self._closed = True
        self._changed.set()


class Worker:
    """One worker process and the way to talk to it. All methods belong on the event loop."""

    def __init__(
        self,
        name: str,
        servant: str,
        arguments: tuple[Any, ...] = (),
        *,
        limits: Mapping[str, int] | None = None,
        max_age_s: Mapping[str, float] | None = None,
        head_start_s: float = 0.0,
        on_event: Callable[[Any], None] | None = None,
        on_death: Callable[[str], None] | None = None,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        """`servant` is "package.module:Class"; its first argument is a function that sends an event here.

        Until its first event, at most for `head_start_s`, it runs as important as the station itself: a dead worker is
        soon replaced, however busy the others are.
        `on_failure` is told in a sentence what a posted request raised: nobody waits for an answer to it.
        """
        self.name = name
        self._servant = servant
        self._arguments = arguments
        self._head_start_s = head_start_s
        self._outbox = Outbox(limits or {}, max_age_s)
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
    def dropped(self) -> Mapping[str, int]:
        """How many requests of each limited kind found the outbox full."""
        return self._outbox.dropped

    def waiting(self, kind: str) -> int:
        """How many requests of a kind wait to be sent."""
        return self._outbox.waiting(kind)

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
        writer.transport.set_write_buffer_limits(
            high=0
        )  # what is not sent yet waits in the outbox, where it may be dropped
        self._moving = (
            asyncio.create_task(self._write(writer), name=f"{self.name} requests"),
            asyncio.create_task(self._read(reader, writer), name=f"{self.name} answers"),
        )

    def post(self, method: str, *arguments: Any, kind: str = "") -> bool:
        """Ask without waiting for an answer. False when an older request of this kind was dropped for it."""
        if self._dead or self._closing:
            return False
        return self._outbox.put(kind or method, (None, method, arguments))

    async def call(self, method: str, *arguments: Any) -> Any:
        """Ask, and wait for the answer. Raises what the servant raised, or WorkerDied."""
        return await self.ask(method, *arguments)

    def ask(self, method: str, *arguments: Any) -> asyncio.Future[Any]:
        """As `call`, and the request stands in line already when this returns: what is posted later comes later."""
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
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
        self._outbox.put("call", (number, method, arguments))
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
            self._outbox.put("end", (None, END, ()))
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
                target=_serve,
                args=(theirs, self.name, self._head_start_s, self._servant, self._arguments),
                name=self.name,
                daemon=True,
            )
            self._process.start()

    async def _write(self, writer: asyncio.StreamWriter) -> None:
        while (item := await self._outbox.take()) is not None:
            try:
                data = pickle.dumps(item, pickle.HIGHEST_PROTOCOL)
            except Exception as exc:  # pickling runs the code of what it is given
                self._take((item[0], False, WorkerFailed(f"{item[1]} cannot be sent: {exc}")))
                continue
            try:
                writer.write(LENGTH.pack(len(data)) + data)  # some Pythons' `writelines` never make `drain` wait
                await writer.drain()
            except OSError:
                return  # the reader notices the end and reports it

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                (length,) = LENGTH.unpack(await reader.readexactly(LENGTH.size))
                message = pickle.loads(await reader.readexactly(length))  # from our own child  # noqa: S301  # nosec B301
                self._take(message)
        except (asyncio.IncompleteReadError, OSError):
            await asyncio.to_thread(self._process.join, END_TIMEOUT_S)
            self._end()
        finally:
            writer.close()

    def _take(self, message: tuple[int | None, bool, Any]) -> None:
        try:
            self._receive(message)
        except Exception:  # on top of what others do with an event: it must not cost the worker
            logger.exception("%s worker: what it said could not be taken", self.name)

    def _receive(self, message: tuple[int | None, bool, Any]) -> None:
        call, is_ok, value = message
        if call is None:
            if not is_ok:
                logger.error("%s worker: %s", self.name, value)
                if self._on_failure is not None:
                    self._on_failure(str(value))
            elif self._on_event is not None:
                self._on_event(value)
            return
        future = self._calls.get(call)
        if future is None or future.done():
            return
        if is_ok:
            future.set_result(value)
        else:
            future.set_exception(value)

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


class _Line:
    """The worker's end of the pipe."""

    def __init__(self, line: socket.socket) -> None:
        self._line = line
        self._arrivals = select.poll()
        self._arrivals.register(line, select.POLLIN)

    def has_request(self) -> bool:
        """Whether one waits, or the station is gone, which `receive` tells."""
        return bool(self._arrivals.poll(0))

    def receive(self) -> Any:
        """Wait for a request. Raises EOFError, OSError when the station is gone."""
        (length,) = LENGTH.unpack(self._read(LENGTH.size))
        return pickle.loads(self._read(length))  # from our own parent  # noqa: S301  # nosec B301

    def send(self, message: object) -> None:
        """Raises OSError when the station is gone."""
        data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        self._line.sendall(LENGTH.pack(len(data)) + data)

    def _read(self, size: int) -> bytearray:
        data = bytearray(size)
        rest = memoryview(data)
        while rest:
            taken = self._line.recv_into(rest)
            if not taken:
                raise EOFError
            rest = rest[taken:]
        return data


def resolve(path: str) -> Any:
    """The object a "package.module:name" names."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def _nothing_to_do() -> bool:
    return False


class _Importance:
    """A worker gives way to the event loop, but for its head start."""

    def __init__(self, head_start_s: float) -> None:
        self._nice_from_s = time.monotonic() + head_start_s
        self._is_nice = False

    def end_head_start(self) -> None:
        self._nice_from_s = -math.inf

    def settle(self) -> None:
        """Before a piece of work."""
        if not self._is_nice and time.monotonic() >= self._nice_from_s:
            os.nice(NICE)
            self._is_nice = True


def _serve(line: socket.socket, name: str, head_start_s: float, servant_path: str, arguments: tuple[Any, ...]) -> None:
    """The worker process: requests in, answers and events out, until the pipe closes.

    A servant may have `catch_up`: a piece of work that can wait until there are no requests; False when there is none.
    """
    pipe = _Line(line)
    importance = _Importance(head_start_s)
    with contextlib.suppress(OSError):  # `top` shows which robot's worker it is; only Linux has this file
        Path("/proc/self/comm").write_text(name[:15])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the station's to handle
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")

    def emit(event: object) -> None:
        pipe.send((None, True, event))
        importance.end_head_start()

    servant = resolve(servant_path)(emit, *arguments)
    catch_up: Callable[[], bool] = getattr(servant, "catch_up", _nothing_to_do)
    while True:
        try:
            while not pipe.has_request() and catch_up():
                pass
        except Exception:  # the work that could wait fails again where it is needed, and is told there
            logger.exception("catching up failed")
            catch_up = _nothing_to_do
        try:
            call, method, values = pipe.receive()
        except (EOFError, OSError):
            return
        if method == END:
            return
        importance.settle()
        try:
            answer = (call, True, getattr(servant, method)(*values))
        except RobotSystemError as exc:
            answer = (call, False, exc)
        except Exception as exc:  # the one broad catch: a bug in one request must reach its caller, not end the worker
            logger.exception("%s failed", method)
            answer = (call, False, WorkerFailed(f"{method} failed: {type(exc).__name__}: {exc}"))
        if call is not None or not answer[1]:
            try:
                pipe.send(answer)
            except OSError:
                return
