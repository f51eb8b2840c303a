"""robot-server for bench_stop: the real server and Mega adapters, a camera that can misbehave, and a log of the line.

Lines on stdin break it: `block S` (busy event loop), `sleep S` (blocked event loop), `camera hang|flood|normal`,
`clock S` (the wall clock jumps); `count` prints the frames made. The log has one line per drive or stop frame, stamped
around the write to the serial line (`before after drive|stop`, monotonic ns), and `begin end block` or `unblock` for
each blocked event loop.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import threading
import time
from collections.abc import Callable

from robot.app import serve_until_signal
from robot.config import PiConfig, RobotConfig, ServerConfig
from robot.devices.pi.adapter import geometry_of, mega_settings
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_parts import MegaImu, MegaMotors
from robot.devices.pi.serial_line import PySerialLine
from robot.devices.ports import CapturedFrame, DeviceSet
from robot.server import RobotServer
from shared.calibration import REFERENCE_ROBOT
from shared.listening import bind
from shared.serial_protocol import Type

FLOOD_BYTES = 200_000


class Log:
    """Lines that are in the file when `note` returns."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def note(self, before_ns: int, what: str) -> None:
        os.write(self._fd, f"{before_ns} {time.monotonic_ns()} {what}\n".encode())


class LoggedLine:
    """A serial line that notes what the motors were told, and when."""

    def __init__(self, line: PySerialLine, log: Log) -> None:
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


class BenchCamera:
    """Frames at their rate; or none; or as many as the loop takes."""

    def __init__(self, rate_hz: float, frame_bytes: int) -> None:
        self.mode = "normal"
        self._period_s, self._bytes = 1.0 / rate_hz, frame_bytes
        self._due_s = time.monotonic()
        self.count = 0

    async def capture(self) -> CapturedFrame:
        while self.mode == "hang":
            await asyncio.sleep(0.05)
        flood = self.mode == "flood"
        now_s = time.monotonic()
        self._due_s = max(self._due_s + self._period_s, now_s)
        await asyncio.sleep(0.0 if flood else self._due_s - now_s)
        self.count += 1
        size = FLOOD_BYTES if flood else self._bytes
        return CapturedFrame(time.monotonic_ns(), 5_000_000, 640, 480, bytes(size))

    async def close(self) -> None: ...


def busy(seconds: float) -> None:
    """Holds the event loop and the interpreter."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def hold(log: Log, how: Callable[[float], None], seconds: float) -> None:
    """Runs on the event loop, and says so first."""
    begin_ns = time.monotonic_ns()
    log.note(begin_ns, "block")
    how(seconds)
    log.note(begin_ns, "unblock")


def listen(loop: asyncio.AbstractEventLoop, camera: BenchCamera, log: Log) -> None:
    """Obey stdin in a thread of its own."""
    real_time: Callable[[], float] = time.time
    for line in sys.stdin:
        word, _, value = line.strip().partition(" ")
        if word in ("block", "sleep"):
            loop.call_soon_threadsafe(hold, log, busy if word == "block" else time.sleep, float(value))
        elif word == "camera":
            camera.mode = value
        elif word == "count":
            print(f"frames {camera.count}", flush=True)
        elif word == "clock":
            offset = float(value)
            time.time = lambda offset=offset: real_time() + offset  # type: ignore[misc]
            time.time_ns = lambda offset=offset: round((real_time() + offset) * 1e9)  # type: ignore[misc]


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--serial", required=True)
    parser.add_argument("--log", required=True)
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--frame-bytes", type=int, default=30_000)
    options = parser.parse_args()
    config = PiConfig(serial_port=options.serial)
    log = Log(options.log)
    mega = Mega(lambda: LoggedLine(PySerialLine(config.serial_port), log), *mega_settings(config))
    camera = BenchCamera(options.rate_hz, options.frame_bytes)
    devices = DeviceSet(
        calibration=REFERENCE_ROBOT,
        camera=camera,
        imu=MegaImu(mega),
        motors=MegaMotors(mega, geometry_of(config)),
    )
    server_config = RobotConfig(server=ServerConfig(port=0))
    listener = bind("127.0.0.1", 0)
    threading.Thread(target=listen, args=(asyncio.get_running_loop(), camera, log), daemon=True).start()
    print(f"port {listener.getsockname()[1]}", flush=True)
    await serve_until_signal(RobotServer(devices, server_config), listener)


if __name__ == "__main__":
    asyncio.run(main())
