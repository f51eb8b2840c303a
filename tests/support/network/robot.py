"""robot-server with simulated devices, and a log of what its motors are told.

    python -m tests.support.network.robot CONFIG.toml LOG [tcp]

It is the program itself (`robot.app`) with other motors: these note each word to them and pass it on.
With `tcp` it has no UDP port, as an older one.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from pathlib import Path

from robot import app
from robot.config import RobotConfig, load_config
from robot.datagram_port import DatagramPort
from robot.devices.ports import DeviceSet, Motors
from tests.support.network.judging import Told


class NotedMotors:
    """Writes down when the motors were told what, before they are."""

    def __init__(self, motors: Motors, log: Path) -> None:
        self._motors = motors
        self._fd = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        os.write(self._fd, Told(time.monotonic_ns(), linear_m_s, angular_rad_s).packed)
        self._motors.drive(linear_m_s, angular_rad_s, until_ns)

    def stop(self) -> str:
        os.write(self._fd, Told(time.monotonic_ns(), 0.0, 0.0).packed)
        return self._motors.stop()

    def close(self) -> None:
        self._motors.close()


def main(settings: str, log: str, way: str = "") -> None:
    if way == "tcp":
        DatagramPort.open = lambda *_: None  # type: ignore[method-assign]
    open_real = app.open_devices

    def open_noted(kind: app.DeviceKind, config: RobotConfig) -> DeviceSet:
        devices = open_real(kind, config)
        assert devices.motors is not None
        noted: Motors = NotedMotors(devices.motors, Path(log))
        return dataclasses.replace(devices, motors=noted)

    app.open_devices = open_noted
    app.run("simulated", load_config(Path(settings), {}))


if __name__ == "__main__":
    main(*sys.argv[1:])
