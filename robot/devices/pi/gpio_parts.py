"""Motors and servos wired to the Pi itself: commands go to a small process that owns the pins (gpio_pins.py)."""

from __future__ import annotations

import logging
import math
import os
import select
import subprocess
import sys
import threading
import time

from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega_parts import FIRMWARE_TTL_MS
from shared.errors import DeviceLost, DeviceUnavailable

logger = logging.getLogger(__name__)

START_TIMEOUT_S = 10.0
PROGRAM = [sys.executable, "-m", "robot.devices.pi.gpio_pins"]


class GpioProcess:
    """The process that owns the pins. Outlives a killed robot-server just long enough to stop the motors."""

    def __init__(self, pins: tuple[int, int, int, int, int, int], command: list[str] | None = None) -> None:
        """Starts it. Raises DeviceUnavailable where the pins cannot be had."""
        command = command or [*PROGRAM, *map(str, pins)]
        # A session of its own: Ctrl-C must reach robot-server first, which stops the motors in order.
        # Its stderr is ours: a pipe nobody reads would fill, and the process would wait in its own complaint.
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        self._lock = threading.Lock()
        assert self._process.stdin is not None and self._process.stdout is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        readable, _, _ = select.select([self._process.stdout], [], [], START_TIMEOUT_S)
        if not readable or self._process.stdout.readline().strip() != b"ready":
            self._process.kill()
            self.close()
            raise DeviceUnavailable(
                "the motor pins cannot be used (its process says why above); run robot/install.sh on the Pi and check"
                " `pi.gpio_pins`"
            )

    def send(self, line: str) -> None:
        """Raises DeviceLost when the process has ended or does not read."""
        assert self._process.stdin is not None
        with self._lock:
            try:
                os.write(self._process.stdin.fileno(), line.encode() + b"\n")
            except (OSError, ValueError) as exc:
                raise DeviceLost(f"the motor pins' process is gone ({exc}); restart robot-server") from exc

    def close(self) -> None:
        """Motors off, process ended. Safe to call twice."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class GpioMotors:
    """Two motors by gpiozero."""

    def __init__(self, process: GpioProcess, geometry: DriveGeometry) -> None:
        self._process, self._geometry = process, geometry

    def drive(self, linear_m_s: float, angular_rad_s: float) -> None:
        left, right = self._geometry.duties(linear_m_s, angular_rad_s)
        until_ms = time.monotonic_ns() // 1_000_000 + FIRMWARE_TTL_MS
        self._process.send(f"drive {left} {right} {until_ms}")

    def stop(self) -> None:
        try:
            self._process.send("stop")
        except DeviceLost as exc:
            logger.debug("stop not sent: %s", exc)

    def close(self) -> None:
        self.stop()
        self._process.close()


class GpioPanTilt:
    """Two servos by gpiozero: 1500 us is straight ahead."""

    def __init__(self, process: GpioProcess) -> None:
        self._process = process

    def point(self, pan_rad: float, tilt_rad: float) -> None:
        pan, tilt = (round(1500.0 + max(-1.0, min(1.0, a * 2 / math.pi)) * 1000.0) for a in (pan_rad, tilt_rad))
        self._process.send(f"servo {pan} {tilt}")

    def close(self) -> None:
        try:
            self._process.send("servo 0 0")
        except DeviceLost as exc:
            logger.debug("servos not released: %s", exc)
