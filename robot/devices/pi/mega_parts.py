"""IMU, motors, pan-tilt and battery as the Mega has them, behind the device ports."""

from __future__ import annotations

import logging
import math

from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.ports import BatteryState, ImuReading
from shared.errors import DeviceLost, HardwareError
from shared.serial_protocol import Flag, Servo, Stop

logger = logging.getLogger(__name__)

# Ten reports a second: a longer silence is a line that stands still, and whoever drives must be told so.
SILENT_NS = 500_000_000


class MegaImu:
    def __init__(self, mega: Mega) -> None:
        self._mega = mega

    async def read(self) -> list[ImuReading]:
        return await self._mega.wait_readings()

    async def close(self) -> None:
        self._mega.close()


class MegaMotors:
    """Motors on the Mega's DRV8833. The firmware stops them when commands stop coming."""

    def __init__(self, mega: Mega, geometry: DriveGeometry) -> None:
        self._mega = mega
        self._geometry = geometry

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        """Raises DeviceLost when the Mega is away, silent, or holds the motors off."""
        if (silence_ns := self._mega.silence_ns) > SILENT_NS:
            raise DeviceLost(f"the Mega has been silent for {silence_ns / 1e9:.1f} s; not driving until it is heard")
        left, right = self._geometry.duties(linear_m_s, angular_rad_s)
        self._mega.drive(left, right, until_ns)
        status = self._mega.status
        if status is not None and status.flags & Flag.LOW_BATTERY:
            raise DeviceLost(f"the motors' battery is low ({status.battery_mv / 1000:.1f} V); charge it")

    def stop(self) -> str:
        try:
            self._mega.send(Stop())
        except HardwareError as exc:
            logger.debug("stop not sent (%s); the firmware stops by itself", exc)
            return str(exc)
        silence_ns = self._mega.silence_ns
        return "" if silence_ns <= SILENT_NS else f"the Mega has been silent for {silence_ns / 1e9:.1f} s"

    def close(self) -> None:
        self.stop()


class MegaPanTilt:
    """Two hobby servos: 1500 us is straight ahead."""

    US_PER_RAD = 2000.0 / math.pi  # 90 degrees are 1000 us

    def __init__(self, mega: Mega) -> None:
        self._mega = mega

    def point(self, pan_rad: float, tilt_rad: float) -> None:
        pan, tilt = (round(min(2500.0, max(500.0, 1500.0 + a * self.US_PER_RAD))) for a in (pan_rad, tilt_rad))
        self._mega.send(Servo(pan, tilt))

    def close(self) -> None:
        try:
            self._mega.send(Servo(0, 0))
        except HardwareError as exc:
            logger.debug("servos not released: %s", exc)


class MegaBattery:
    """The divider on the Mega's A0."""

    def __init__(self, mega: Mega, empty_v: float, full_v: float) -> None:
        self._mega = mega
        self._empty_v, self._full_v = empty_v, full_v

    def read(self) -> BatteryState:
        status = self._mega.status
        if status is None or self._mega.lost:
            raise DeviceLost(self._mega.lost or "the Mega has not reported its battery yet")
        return battery_state(status.battery_mv / 1000.0, self._empty_v, self._full_v)


def battery_state(voltage_v: float, empty_v: float, full_v: float) -> BatteryState:
    """Charge by a straight line between empty and full: a hint, not a gauge."""
    fraction = (voltage_v - empty_v) / (full_v - empty_v)
    return BatteryState(voltage_v=voltage_v, fraction=min(1.0, max(0.0, fraction)))
