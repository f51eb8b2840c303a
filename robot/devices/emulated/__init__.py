"""The real firmware in an emulated Mega, behind the real robot's adapters: `robot-server --imu emulated`."""

from robot.devices.emulated.adapter import open_emulated
from robot.devices.emulated.board import EmulatedBoard

__all__ = ["EmulatedBoard", "open_emulated"]
