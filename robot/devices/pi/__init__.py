"""The real robot: camera on the Pi, IMU and motors on the Mega (or motors on the Pi's own pins)."""

from robot.devices.pi.adapter import open_pi

__all__ = ["open_pi"]
