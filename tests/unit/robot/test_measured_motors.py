"""Motors that are asked for so much that the command comes true."""

from __future__ import annotations

from robot.measured_motors import MeasuredMotors
from shared.calibration import WheelCalibration


class Noted:
    """Motors that note what they are told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, float, int]] = []
        self.is_closed = False

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        self.told.append((linear_m_s, angular_rad_s, until_ns))

    def stop(self) -> str:
        return "the cable is loose"

    def close(self) -> None:
        self.is_closed = True


def test_motors_are_asked_for_what_makes_the_command_come_true() -> None:
    inner = Noted()
    wheels = [WheelCalibration()]
    motors = MeasuredMotors(inner, lambda: wheels[-1])
    motors.drive(0.2, -0.5, 7)
    wheels.append(WheelCalibration(speed=0.8, turn=0.25))
    motors.drive(0.2, -0.5, 8)
    assert inner.told == [(0.2, -0.5, 7), (0.25, -2.0, 8)]


def test_a_stop_and_its_fault_pass_through() -> None:
    inner = Noted()
    motors = MeasuredMotors(inner, WheelCalibration)
    assert motors.stop() == "the cable is loose"
    motors.close()
    assert inner.is_closed
