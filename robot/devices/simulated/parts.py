"""The simulated robot seen through each device's port."""

from __future__ import annotations

import secrets

from robot.devices.ports import BatteryState, CapturedDepth, CapturedFrame, ImuReading
from robot.devices.simulated.robot import SimulatedRobot

MAX_READINGS = 225  # a second's worth, as the port says


class _Part:
    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot


class SimulatedCameraPort(_Part):
    """Delivers the newest frame; its stamp is late by the calibration's time shift, as the real camera's is."""

    async def capture(self) -> CapturedFrame:
        return (await self._robot.frame_mailbox.get())[-1]

    async def close(self) -> None:
        self._robot.close()


class SimulatedDepthPort(_Part):
    """Delivers the newest depth picture."""

    async def measure(self) -> CapturedDepth:
        return (await self._robot.depth_mailbox.get())[-1]

    async def close(self) -> None:
        self._robot.close()


class SimulatedImu(_Part):
    async def read(self) -> list[ImuReading]:
        return await self._robot.imu_mailbox.get(MAX_READINGS)

    async def close(self) -> None:
        self._robot.close()


class SimulatedMotors(_Part):
    """Drives the simulated body."""

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        self._robot.command(linear_m_s, angular_rad_s, until_ns)

    def stop(self) -> str:
        self._robot.halt()
        return ""

    def close(self) -> None:
        self.stop()


class SimulatedPanTilt(_Part):
    def point(self, pan_rad: float, tilt_rad: float) -> None:
        self._robot.point_head(pan_rad, tilt_rad)

    def close(self) -> None:
        self._robot.point_head(0.0, 0.0)


class SimulatedBattery(_Part):
    """Drains slowly, faster while driving."""

    def read(self) -> BatteryState:
        return self._robot.battery()


class SimulatedHijack(_Part):
    def hijack(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        self._robot.hijack(x_m, y_m, yaw_rad)

    def hijack_anywhere(self) -> None:
        """To a free spot of another room; in a world of one room anywhere in it."""
        self._robot.hijack(*self._robot.spot_in_another_room(secrets.randbits(32)))
