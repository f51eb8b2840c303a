"""Motors of which it was measured what they make of a command: asked for so much that the command comes true."""

from __future__ import annotations

from collections.abc import Callable

from robot.devices.ports import Motors
from shared.calibration import WheelCalibration


class MeasuredMotors(Motors):
    """Beyond what the motors can, they do what they can."""

    def __init__(self, motors: Motors, wheels: Callable[[], WheelCalibration]) -> None:
        """`wheels`: as the robot's calibration tells them now; it changes only while the robot stands."""
        self._motors = motors
        self._wheels = wheels

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        wheels = self._wheels()
        self._motors.drive(linear_m_s / wheels.speed, angular_rad_s / wheels.turn, until_ns)

    def stop(self) -> str:
        return self._motors.stop()

    def close(self) -> None:
        self._motors.close()
