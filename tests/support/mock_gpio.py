"""The process that owns the motor pins, on gpiozero's mock pins: `python -m tests.support.mock_gpio LOG PIN…`.

Each change of a pin is a line in LOG: its number and its state (0..1, a duty where PWM runs).
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from gpiozero import Device
from gpiozero.pins.mock import MockFactory, MockPWMPin

from robot.devices.pi import gpio_pins


class LoggedPin(MockPWMPin):  # type: ignore[misc]  # gpiozero has no types
    """A pin that tells what it is set to."""

    fd = -1

    def _set_state(self, value: Any) -> None:
        super()._set_state(value)
        os.write(self.fd, f"{self.info.name.removeprefix('GPIO')} {float(value):.3f}\n".encode())


def states(log: Path) -> dict[int, float]:
    """What each pin was set to last."""
    lines = log.read_text().rpartition("\n")[0].splitlines() if log.exists() else []
    return {int(number): float(state) for number, state in (line.split() for line in lines)}


def main() -> None:
    LoggedPin.fd = os.open(sys.argv.pop(1), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    Device.pin_factory = MockFactory(pin_class=LoggedPin)
    gpio_pins.main()


if __name__ == "__main__":
    main()
