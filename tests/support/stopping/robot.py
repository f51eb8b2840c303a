"""robot-server for bench_stop: the real server with the real robot's adapters, and a log of the line.

Only two things are not the Pi's own: picamera2 is the tests' stand-in (../pi_stubs.py) under the real camera adapter
and its thread, and the Mega is the emulated one. Lines on stdin break it: `busy` or `asleep` (blocks the event loop
until `go on`), `camera hang` (the adapter's thread stays in picamera2's call), `camera flood` (frames of noise as fast
as they can be taken), `camera normal`, `hold` (picamera2's call keeps the interpreter to itself, as a C library that
does not let go of it, until a byte comes through the fifo of `--hold`), `wall` (notes what the wall clock says);
`count` prints the frames made. The log has one line per drive or stop frame, stamped around the write to the serial
line (`before after drive|stop`, monotonic ns), and `begin end block` or `unblock` for each blocked event loop or held
interpreter. With `--ready-frames BYTES` the camera's pictures come compressed, for bench_robot_cpu.
"""

from __future__ import annotations

import argparse
import asyncio
import ctypes
import dataclasses
import functools
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from robot.app import serve_until_signal
from robot.config import PiConfig, RobotConfig, ServerConfig
from robot.devices.pi import adapter
from robot.devices.pi.serial_line import PySerialLine, SerialLine
from robot.devices.ports import CapturedFrame, DeviceSet
from robot.server import RobotServer
from shared.listening import bind
from shared.serial_protocol import Type
from tests.support import pi_stubs
from tests.support.pi_stubs import StubPicamera2


class Log:
    """Lines that are in the file when `note` returns."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def note(self, before_ns: int, what: str) -> None:
        os.write(self._fd, f"{before_ns} {time.monotonic_ns()} {what}\n".encode())


class LoggedLine:
    """A serial line that notes what the motors were told, and when."""

    def __init__(self, line: SerialLine, log: Log) -> None:
        self._line, self._log = line, log

    def read(self) -> bytes:
        return self._line.read()

    def write(self, data: bytes) -> None:
        before_ns = time.monotonic_ns()
        self._line.write(data)
        if data[1] in (Type.DRIVE, Type.STOP):
            self._log.note(before_ns, "drive" if data[1] == Type.DRIVE else "stop")

    def close(self) -> None:
        self._line.close()


class ReadyCamera:
    """Compressed frames at their rate, which cost no work."""

    def __init__(self, rate_hz: float, frame_bytes: int) -> None:
        self._period_s, self._bytes = 1.0 / rate_hz, frame_bytes
        self._due_s = time.monotonic()
        self.count = 0

    async def capture(self) -> CapturedFrame:
        now_s = time.monotonic()
        self._due_s = max(self._due_s + self._period_s, now_s)
        await asyncio.sleep(self._due_s - now_s)
        self.count += 1
        return CapturedFrame(time.monotonic_ns(), 5_000_000, 640, 480, bytes(self._bytes))

    async def close(self) -> None: ...


class HoldingPicamera2(pi_stubs.StubPicamera2):
    """Picamera2 whose next call may keep the interpreter to itself: no other thread of Python runs."""

    holds = False
    fifo = -1
    log: Log

    def capture_request(self, wait: Any = None, signal_function: Any = None, flush: Any = None) -> pi_stubs.StubRequest:
        if HoldingPicamera2.holds:
            HoldingPicamera2.holds = False
            # PyDLL: unlike CDLL it does not let go of the interpreter while the C function runs.
            block(self.log, lambda: ctypes.PyDLL(None).read(self.fifo, ctypes.create_string_buffer(1), 1))
        return super().capture_request(wait, signal_function, flush)


def block(log: Log, until: Callable[[], object]) -> None:
    """Runs on the thread that is to stand still, and says so first."""
    begin_ns = time.monotonic_ns()
    log.note(begin_ns, "block")
    until()
    log.note(begin_ns, "unblock")


def busy_until(event: threading.Event) -> None:
    """Takes what it can get of the interpreter."""
    while not event.is_set():
        pass


def listen(loop: asyncio.AbstractEventLoop, log: Log, count: Callable[[], int]) -> None:
    """Obey stdin in a thread of its own."""
    goes_on = threading.Event()
    for line in sys.stdin:
        word, _, value = line.strip().partition(" ")
        if word in ("busy", "asleep"):
            goes_on.clear()
            until = functools.partial(busy_until, goes_on) if word == "busy" else goes_on.wait
            loop.call_soon_threadsafe(block, log, until)
        elif word == "go":
            goes_on.set()
        elif word == "camera":
            StubPicamera2.floods = value == "flood"
            StubPicamera2.stuck.clear() if value == "hang" else StubPicamera2.stuck.set()
        elif word == "hold":
            HoldingPicamera2.holds = True
        elif word == "wall":
            log.note(time.monotonic_ns(), f"wall:{time.time_ns()}")
        elif word == "count":
            print(f"frames {count()}", flush=True)


def open_devices(options: argparse.Namespace, log: Log) -> DeviceSet:
    """The real robot's, behind a line that is logged."""
    config = PiConfig(serial_port=options.serial, rate_hz=options.rate_hz, camera=not options.ready_frames)
    adapter.__dict__["PySerialLine"] = lambda path: LoggedLine(PySerialLine(path), log)
    pi_stubs.install()
    sys.modules["picamera2"].__dict__["Picamera2"] = HoldingPicamera2
    HoldingPicamera2.log = log
    if options.hold:
        HoldingPicamera2.fifo = os.open(options.hold, os.O_RDWR)
    devices = adapter.open_pi(config)
    if options.ready_frames:
        devices = dataclasses.replace(devices, camera=ReadyCamera(options.rate_hz, options.ready_frames))
    return devices


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--serial", required=True)
    parser.add_argument("--log", required=True)
    parser.add_argument("--hold", default="", help="fifo")
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--ready-frames", type=int, default=0)
    options = parser.parse_args()
    log = Log(options.log)
    devices = open_devices(options, log)
    camera = devices.camera
    count = (lambda: camera.count) if isinstance(camera, ReadyCamera) else (lambda: 0)
    listener = bind("127.0.0.1", 0)
    threading.Thread(target=listen, args=(asyncio.get_running_loop(), log, count), daemon=True).start()
    print(f"port {listener.getsockname()[1]}", flush=True)
    await serve_until_signal(RobotServer(devices, RobotConfig(server=ServerConfig(port=0))), listener)


if __name__ == "__main__":
    asyncio.run(main())
