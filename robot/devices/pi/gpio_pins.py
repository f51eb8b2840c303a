"""DRV8833 and servos on the Pi's own pins, through gpiozero. The only file that imports it.

Runs as a process of its own (`python -m robot.devices.pi.gpio_pins`), because these motors have no firmware watchdog:
it stops them when commands stop coming, also when robot-server was stopped or killed. Lines on stdin:
`drive LEFT RIGHT UNTIL_MS` (permille; monotonic clock of this computer: a line that waited is old), `stop`,
`servo PAN_US TILT_US` (0 lets go). The end of stdin ends it, motors off; so do SIGTERM, SIGINT, SIGHUP and SIGABRT.
SIGKILL does not: the pins keep what they had until robot-server has started another one (docs/robot.md).
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from types import FrameType
from typing import Any, Protocol


class Pins(Protocol):
    """What the guard moves."""

    def drive(self, left: int, right: int) -> None: ...

    def stop(self) -> None: ...

    def servo(self, pan_us: int, tilt_us: int) -> None: ...


class GpioPins:
    """The pins, by gpiozero's names."""

    def __init__(self, left: tuple[int, int], right: tuple[int, int], servos: tuple[int, int]) -> None:
        from gpiozero import Motor, Servo

        self._motors: list[Any] = [Motor(*left, pwm=True), Motor(*right, pwm=True)]
        limits = {"min_pulse_width": 0.0005, "max_pulse_width": 0.0025, "initial_value": None}
        self._servos: list[Any] = [Servo(pin, **limits) for pin in servos]

    def drive(self, left: int, right: int) -> None:
        """Permille, positive forward."""
        for motor, duty in zip(self._motors, (left, right), strict=True):
            motor.value = max(-1.0, min(1.0, duty / 1000.0))

    def stop(self) -> None:
        for motor in self._motors:
            motor.stop()

    def servo(self, pan_us: int, tilt_us: int) -> None:
        for servo, us in zip(self._servos, (pan_us, tilt_us), strict=True):
            servo.value = None if us == 0 else max(-1.0, min(1.0, (us - 1500) / 1000.0))


class Guard:
    """Motion lasts as long as its time to live. Pure: time is an argument."""

    def __init__(self, pins: Pins) -> None:
        self._pins = pins
        self._until_s: float | None = None

    def line(self, text: str, now_s: float) -> None:
        """One command. What is old or cannot be understood stops the motors."""
        words = text.split()
        try:
            numbers = [int(w) for w in words[1:]]
            if words[0] == "drive" and len(numbers) == 3 and numbers[2] > 1000.0 * now_s:
                self._pins.drive(numbers[0], numbers[1])
                self._until_s = min(numbers[2] / 1000.0, now_s + 0.4)
            elif words[0] == "servo" and len(numbers) == 2:
                self._pins.servo(*numbers)
            else:
                self.stop()
        except (ValueError, IndexError):
            self.stop()

    def stop(self) -> None:
        self._pins.stop()
        self._until_s = None

    def tick(self, now_s: float) -> float | None:
        """Stop when the time is up. Returns how long it may still take, None at rest."""
        if self._until_s is None:
            return None
        if now_s >= self._until_s:
            self.stop()
            return None
        return self._until_s - now_s


# SIGABRT is what systemd's watchdog sends, to us too.
ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGABRT)


def _end(number: int, _frame: FrameType | None) -> None:
    for other in ENDING:  # a second one must not end the stopping
        signal.signal(other, signal.SIG_IGN)
    raise SystemExit(128 + number)


def serve(guard: Guard, fd: int) -> None:
    """Obey lines from a file descriptor until it ends or a signal ends us."""
    buffer = b""
    try:
        for number in ENDING:
            signal.signal(number, _end)
        while True:
            readable, _, _ = select.select([fd], [], [], guard.tick(time.monotonic()))
            if not readable:
                continue
            data = os.read(fd, 4096)
            if not data:
                return
            *lines, buffer = (buffer + data).split(b"\n")
            for text in lines:
                guard.line(text.decode("ascii", "replace"), time.monotonic())
            buffer = buffer[-200:]
    finally:
        guard.stop()


def main() -> None:
    """Arguments: six pins (left in1 in2, right in1 in2, pan, tilt)."""
    pins = [int(a) for a in sys.argv[1:7]]
    guard = Guard(GpioPins((pins[0], pins[1]), (pins[2], pins[3]), (pins[4], pins[5])))
    guard.stop()
    print("ready", flush=True)
    serve(guard, sys.stdin.fileno())


if __name__ == "__main__":
    main()
