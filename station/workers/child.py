"""What happens in a worker's process: requests in, answers and events out, until the station is gone."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import pickle
import select
import signal
import socket
import struct
import time
from pathlib import Path
from typing import Any, NamedTuple

from shared.errors import RobotSystemError
from shared.repetition import start_logging
from station.workers.request import Program, ProgramName, WorkerFailed

logger = logging.getLogger(__name__)

NICE = 10  # the event loop comes first: it gets nine times the share of any worker, and there may be twenty busy ones
LENGTH = struct.Struct("!Q")  # before each pickled Asked or Reply


class Asked(NamedTuple):
    """A request as it travels."""

    call: int | None  # its number where somebody waits for the answer
    method: str  # of the program; empty: end
    args: tuple[Any, ...]
    kwargs: dict[str, Any]


CATCH_UP = Asked(None, Program.catch_up.__name__, (), {})


class Reply(NamedTuple):
    """An answer, an error or an event as it travels."""

    call: int | None  # None: an event, or an error that nobody waits for
    is_ok: bool
    value: Any


class Pipe:
    """The process' end of the socket to the station."""

    def __init__(self, socket: socket.socket) -> None:
        self._socket = socket
        self._arrivals = select.poll()
        self._arrivals.register(socket, select.POLLIN)

    def has_request(self) -> bool:
        """Whether one waits, or the station is gone, which `receive` tells."""
        return bool(self._arrivals.poll(0))

    def receive(self) -> Asked:
        """Wait for a request. Raises EOFError, OSError when the station is gone."""
        (length,) = LENGTH.unpack(self._read(LENGTH.size))
        asked: Asked = pickle.loads(self._read(length))  # from our own parent  # noqa: S301  # nosec B301
        return asked

    def send(self, reply: Reply) -> None:
        """Raises OSError when the station is gone."""
        data = pickle.dumps(reply, pickle.HIGHEST_PROTOCOL)
        self._socket.sendall(LENGTH.pack(len(data)) + data)

    def _read(self, size: int) -> bytearray:
        data = bytearray(size)
        rest = memoryview(data)
        while rest:
            count = self._socket.recv_into(rest)
            if not count:
                raise EOFError
            rest = rest[count:]
        return data


class Importance:
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


def run_worker(socket: socket.socket, name: str, head_start_s: float, program_name: ProgramName[Any, Any]) -> None:
    """The process' main function: run a program until the pipe closes."""
    pipe = Pipe(socket)
    importance = Importance(head_start_s)
    with contextlib.suppress(OSError):  # `top` shows which robot's worker it is; only Linux has this file
        Path("/proc/self/comm").write_text(name[:15])
    for number in (signal.SIGINT, signal.SIGHUP):  # Ctrl-C and a closed terminal are the station's to handle
        signal.signal(number, signal.SIG_IGN)
    start_logging(logging.INFO, "%(levelname)s %(name)s: %(message)s")

    def emit(event: object) -> None:
        pipe.send(Reply(None, True, event))
        importance.end_head_start()

    program: Program = program_name.load()(emit)
    told = ""
    while True:
        try:
            told = _catch_up(pipe, program, told)
            asked = pipe.receive()
        except (EOFError, OSError):
            return
        if not asked.method:
            return
        importance.settle()
        reply = _run(program, asked)
        if asked.call is not None or not reply.is_ok:
            try:
                pipe.send(reply)
            except OSError:
                return


def _catch_up(pipe: Pipe, program: Program, told: str) -> str:
    """Do what can wait until a request comes. Where it fails it is tried again after the next request.

    Returns:
        The last failure that was told, at first `told`; one that lasts is told once.

    Raises OSError when the station is gone.
    """
    is_more = True
    while is_more and not pipe.has_request():
        done = _run(program, CATCH_UP, told)
        if not done.is_ok and str(done.value) != told:
            told = str(done.value)
            pipe.send(done)
        is_more = done.is_ok and done.value
    return told


def _run(program: Program, asked: Asked, logged: str = "") -> Reply:
    try:
        # `Worker.ask` was given the method itself, of the interface that this program fills in.
        return Reply(asked.call, True, getattr(program, asked.method)(*asked.args, **asked.kwargs))
    except RobotSystemError as exc:
        return Reply(asked.call, False, exc)
    except Exception as exc:  # the one broad catch: a bug in one request must reach its caller, not end the worker
        what = "work that could wait" if asked is CATCH_UP else asked.method
        failure = WorkerFailed(f"{what} failed: {type(exc).__name__}: {exc}")
        if str(failure) != logged:
            logger.exception("%s failed", what)
        return Reply(asked.call, False, failure)
