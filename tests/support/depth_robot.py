"""A robot-server with a depth sensor that tests push, over a real socket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import msgspec

from robot.devices.ports import CapturedDepth, DeviceSet
from shared.calibration import REFERENCE_ROBOT, DepthCalibration
from tests.support.link import Bench


class FakeDepth:
    """Gives the pictures that a test puts in."""

    def __init__(self) -> None:
        self.pictures: asyncio.Queue[CapturedDepth] = asyncio.Queue()

    async def measure(self) -> CapturedDepth:
        return await self.pictures.get()

    async def close(self) -> None: ...


class DepthBench(Bench):
    """A robot-server with a depth sensor."""

    def __init__(self, sensor: DepthCalibration) -> None:
        super().__init__()
        self.depth = FakeDepth()
        self._sensor = sensor

    def devices(self) -> DeviceSet:
        devices = super().devices()
        calibration = msgspec.structs.replace(REFERENCE_ROBOT, depth=self._sensor)
        return DeviceSet(
            calibration=calibration, camera=devices.camera, imu=devices.imu, motors=devices.motors, depth=self.depth,
            clock=devices.clock,
        )  # fmt: skip


@asynccontextmanager
async def running_robot_with_depth(sensor: DepthCalibration) -> AsyncIterator[DepthBench]:
    bench = DepthBench(sensor)
    await bench.start()
    try:
        yield bench
    finally:
        await bench.stop()
