"""Motors and servos wired to the Pi itself: commands go to a small process that owns the pins (gpio_pins.py)."""

from __future__ import annotations

import logging
import math
import os
import select
import subprocess
import sys
import threading

from robot.devices.pi.kinematics import DriveGeometry
from shared.errors import DeviceLost, DeviceUnavailable

logger = logging.getLogger(__name__)

START_TIMEOUT_S = 10.0
RETRY_S = 1.0
PROGRAM = [sys.executable, "-m", "robot.devices.pi.gpio_pins"]


class GpioProcess:
    """The process that owns the pins. Outlives a killed robot-server just long enough to stop the motors.

    When it is killed itself, the pins keep what it had set: another one is started, and begins by stopping the motors.
    """

    def __init__(self, pins: tuple[int, int, int, int, int, int], command: list[str] | None = None) -> None:
        """Starts it. Raises DeviceUnavailable where the pins cannot be had."""
        self._command = command or [*PROGRAM, *map(str, pins)]
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._reviver: threading.Thread | None = None
        self._process = self._start()

    def send(self, line: str) -> None:
        """Raises DeviceLost when the process has ended or does not read."""
        with self._lock:
            assert self._process.stdin is not None
            try:
                os.write(self._process.stdin.fileno(), line.encode() + b"\n")
            except (OSError, ValueError) as exc:
                self._revive()
                raise DeviceLost(f"the motor pins' process does not take commands ({exc})") from exc

    def close(self) -> None:
        """Motors off, process ended. Safe to call twice."""
        self._closed.set()
        with self._lock:
            _end(self._process)

    def _start(self) -> subprocess.Popen[bytes]:
        # A session of its own: Ctrl-C must reach robot-server first, which stops the motors in order.
        # Its stderr is ours: a pipe nobody reads would fill, and the process would wait in its own complaint.
        process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        assert process.stdin is not None and process.stdout is not None
        os.set_blocking(process.stdin.fileno(), False)
        readable, _, _ = select.select([process.stdout], [], [], START_TIMEOUT_S)
        if not readable or process.stdout.readline().strip() != b"ready":
            process.kill()
            _end(process)
            raise DeviceUnavailable(
                "the motor pins cannot be used (its process says why above); run robot/install.sh on the Pi and check"
                " `pi.gpio_pins`"
            )
        return process

    def _revive(self) -> None:
        """In a thread of its own: whoever stops the motors must not wait for a program to start."""
        has_ended = not self._closed.is_set() and self._process.poll() is not None
        if has_ended and (self._reviver is None or not self._reviver.is_alive()):
            self._reviver = threading.Thread(target=self._start_anew, name="motor-pins", daemon=True)
            self._reviver.start()

    def _start_anew(self) -> None:
        while not self._closed.is_set():
            try:
                process = self._start()
            except (DeviceUnavailable, OSError) as exc:
                logger.error("the motor pins' process does not start anew: %s", exc)
                self._closed.wait(RETRY_S)
                continue
            with self._lock:
                ended, self._process = self._process, process
                _end(ended)
                if self._closed.is_set():
                    _end(process)
            logger.warning("the motor pins' process had ended; another one stopped the motors and takes commands")
            return


def _end(process: subprocess.Popen[bytes]) -> None:
    """The end of its input tells it to stop the motors and to end."""
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
    try:
        process.wait(timeout=2.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class GpioMotors:
    def __init__(self, process: GpioProcess, geometry: DriveGeometry) -> None:
        self._process, self._geometry = process, geometry

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        left, right = self._geometry.duties(linear_m_s, angular_rad_s)
        self._process.send(f"drive {left} {right} {until_ns // 1_000_000}")

    def stop(self) -> str:
        try:
            self._process.send("stop")
        except DeviceLost as exc:
            logger.debug("stop not sent: %s", exc)
            return str(exc)
        return ""

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
