"""What `robot-server` needs of hardware. Simulated, recorded and real devices answer to these small interfaces.

Times are robot monotonic nanoseconds. Blocking drivers keep a thread of their own inside the adapter.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from shared.calibration import Calibration


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """One camera image as it left the encoder."""

    t_robot_ns: int  # mid-exposure of the first image row
    exposure_ns: int
    width: int
    height: int
    jpeg: bytes


@dataclass(frozen=True, slots=True)
class CapturedDepth:
    """What a depth sensor measured at one time, as `DepthCalibration` of the robot's calibration describes it."""

    t_robot_ns: int
    png: bytes  # 16 bit grey: mm along the sensor's axis, 0 or 65535 where nothing was measured


@dataclass(frozen=True, slots=True)
class ImuReading:
    """One inertial sample, stamped when the sensor said it was ready."""

    sequence: int  # counts samples the sensor made, so a hole shows a loss
    t_robot_ns: int
    gyro_imu: tuple[float, float, float]  # rad/s
    accel_imu: tuple[float, float, float]  # m/s^2, specific force: +9.81 along up at rest


@dataclass(frozen=True, slots=True)
class BatteryState:
    voltage_v: float
    fraction: float  # 0..1


class EndOfRecording(Exception):
    """A recorded device has played its last datum."""


class Camera(Protocol):
    """Source of frames in time order."""

    async def capture(self) -> CapturedFrame:
        """Wait for the next frame. Raises DeviceLost when the camera stops, EndOfRecording at a recording's end."""
        ...

    async def close(self) -> None: ...


class Imu(Protocol):
    """Lossless source of inertial samples."""

    async def read(self) -> list[ImuReading]:
        """Wait for at least one sample and return all that came since the last call (at most a second's worth)."""
        ...

    async def close(self) -> None: ...


class DepthSensor(Protocol):
    """Source of depth pictures, or of the few zones of a time-of-flight sensor, in time order."""

    async def measure(self) -> CapturedDepth:
        """Wait for the next one. Raises DeviceLost when the sensor stops, EndOfRecording at a recording's end."""
        ...

    async def close(self) -> None: ...


class Motors(Protocol):
    """Two sides of a skid-steer drive. Calls return at once; `stop` must work from any thread and may not raise."""

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        """Hold a velocity until a monotonic time of this computer.

        The time goes along as far as the motors: a command that was held up on its way moves nothing after its end.
        """

    def stop(self) -> str:
        """Returns why it did not reach the motors, in a sentence; empty: they took it."""
        ...

    def close(self) -> None: ...


class PanTilt(Protocol):
    """Servo head. Angles from straight ahead, positive left and up."""

    def point(self, pan_rad: float, tilt_rad: float) -> None: ...

    def close(self) -> None: ...


class Battery(Protocol):
    def read(self) -> BatteryState: ...


class Hijackable(Protocol):
    """Only simulated robots have this: be picked up and put down elsewhere."""

    def hijack(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Raises ValueError where the robot cannot stand."""
        ...

    def hijack_anywhere(self) -> None:
        """To a free spot, in another room where there is one."""
        ...


@dataclass(frozen=True, slots=True)
class DeviceSet:
    """All devices of one robot; None where the robot has no such part."""

    calibration: Calibration
    camera: Camera | None
    imu: Imu | None
    motors: Motors | None
    depth: DepthSensor | None = None
    pan_tilt: PanTilt | None = None
    battery: Battery | None = None
    hijack: Hijackable | None = None
    problems: Callable[[], dict[str, str]] = dict  # what goes wrong although all answers: name -> sentence
    clock: Callable[[], int] = time.monotonic_ns  # the clock of all t_robot_ns; a recording or simulation has its own

    async def close(self) -> None:
        """What moves first: the IMU's end is the end of the line it may share with motors and servos."""
        for moving in (self.motors, self.pan_tilt):
            if moving is not None:
                moving.close()
        for sensor in (self.imu, self.camera, self.depth):
            if sensor is not None:
                await sensor.close()
