"""robot-server for bench_stop: the real server and Mega adapters, a camera that can misbehave, and a log of the motors.

Lines on stdin break it: `block S` (busy event loop), `sleep S` (blocked event loop), `camera hang|flood|normal`,
`clock S` (the wall clock jumps). The log has one line per motor call: monotonic ns and `drive` or `stop`.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import threading
import time
from collections.abc import Callable

from robot.app import bind, serve_until_signal
from robot.config import PiConfig, RobotConfig, ServerConfig
from robot.devices.pi.adapter import geometry_of, open_mega
from robot.devices.pi.mega_parts import MegaImu, MegaMotors
from robot.devices.ports import CapturedFrame, DeviceSet, Motors
from robot.server import RobotServer
from shared.calibration import REFERENCE_ROBOT

FRAME_BYTES = 30_000
FLOOD_BYTES = 200_000


class LoggedMotors:
    """Passes on, and notes when."""

    def __init__(self, motors: Motors, path: str) -> None:
        self._motors = motors
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def _note(self, what: bytes) -> None:
        os.write(self._fd, b"%d %s\n" % (time.monotonic_ns(), what))

    def drive(self, linear_m_s: float, angular_rad_s: float) -> None:
        self._motors.drive(linear_m_s, angular_rad_s)
        self._note(b"drive")

    def stop(self) -> None:
        self._motors.stop()
        self._note(b"stop")

    def close(self) -> None:
        self._motors.close()


class BenchCamera:
    """Ten frames a second; or none; or as many as the loop takes."""

    def __init__(self) -> None:
        self.mode = "normal"

    async def capture(self) -> CapturedFrame:
        if self.mode == "hang":
            await asyncio.sleep(3600)
        flood = self.mode == "flood"
        await asyncio.sleep(0.0 if flood else 0.1)
        size = FLOOD_BYTES if flood else FRAME_BYTES
        return CapturedFrame(time.monotonic_ns(), 5_000_000, 640, 480, bytes(size))

    async def close(self) -> None: ...


def busy(seconds: float) -> None:
    """Holds the event loop and the interpreter."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def listen(loop: asyncio.AbstractEventLoop, camera: BenchCamera) -> None:
    """Obey stdin in a thread of its own."""
    real_time: Callable[[], float] = time.time
    for line in sys.stdin:
        word, _, value = line.strip().partition(" ")
        if word == "block":
            loop.call_soon_threadsafe(busy, float(value))
        elif word == "sleep":
            loop.call_soon_threadsafe(time.sleep, float(value))
        elif word == "camera":
            camera.mode = value
        elif word == "clock":
            offset = float(value)
            time.time = lambda offset=offset: real_time() + offset  # type: ignore[misc]
            time.time_ns = lambda offset=offset: round((real_time() + offset) * 1e9)  # type: ignore[misc]


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--serial", required=True)
    parser.add_argument("--log", required=True)
    options = parser.parse_args()
    config = PiConfig(serial_port=options.serial)
    mega = open_mega(config)
    camera = BenchCamera()
    devices = DeviceSet(
        calibration=REFERENCE_ROBOT,
        camera=camera,
        imu=MegaImu(mega),
        motors=LoggedMotors(MegaMotors(mega, geometry_of(config)), options.log),
    )
    server_config = RobotConfig(server=ServerConfig(port=0))
    listener = bind(server_config.server)
    threading.Thread(target=listen, args=(asyncio.get_running_loop(), camera), daemon=True).start()
    print(f"port {listener.getsockname()[1]}", flush=True)
    await serve_until_signal(RobotServer(devices, server_config), listener)


if __name__ == "__main__":
    asyncio.run(main())
