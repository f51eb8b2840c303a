"""A simulated robot whose IMU and motors go through the real firmware in an emulated Mega.

The simulated IMU's readings become the emulated chip's registers; the duty at the emulated motor pins moves the
simulated body. A simulated range sensor becomes the echo of an emulated HC-SR04. Between them runs everything the real
robot runs: firmware, serial line, Pi adapters.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import threading
from collections.abc import Awaitable, Callable, Sequence
from functools import partial

import cv2
import numpy as np

from robot.devices.emulated.board import EmulatedBoard
from robot.devices.pi.hc_sr04 import PERIOD, SOUND_M_S, HcSr04
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_parts import MegaBattery, MegaImu, MegaMotors
from robot.devices.pi.serial_line import PySerialLine
from robot.devices.ports import CapturedDepth, DepthSensor, DeviceSet, Imu, ImuReading
from shared.errors import DeviceLost, HardwareError
from shared.serial_protocol import ConfigImu, ConfigMotors

RETRY_S = 0.2
UNTIL_PINS_CHANGE_NS = 2**63 - 1  # a pin holds its level: it is the firmware that ends a motion


class EmulatedImu(MegaImu):
    """The emulated Mega's IMU; closing it ends the board and the feeding."""

    def __init__(self, mega: Mega, board: EmulatedBoard, feeders: Sequence[Feeder]) -> None:
        super().__init__(mega)
        self.board, self._feeders = board, feeders

    async def close(self) -> None:
        await super().close()
        for feeder in self._feeders:
            feeder.close()
        self.board.close()


class Feeder:
    """Moves what another robot's sensor measures into the emulated one, in a thread with an event loop of its own."""

    def __init__(self, commands: Callable[[], Awaitable[list[str]]], board: EmulatedBoard) -> None:
        """`commands`: waits for the next measurements, and gives them as the board's commands."""
        self._commands, self._board = commands, board
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, name="board-feeder", daemon=True)
        self._thread.start()

    def close(self) -> None:
        if self._task is not None:
            self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        self._task = self._loop.create_task(self._feed())
        with contextlib.suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._task)
        self._loop.close()

    async def _feed(self) -> None:
        while True:
            for command in await self._commands():
                try:
                    self._board.command(command)
                except DeviceLost:
                    return


def sample_command(reading: ImuReading) -> str:
    """The board's command that puts a reading into the chip."""
    return "sample " + " ".join(f"{v:.6g}" for v in (*reading.accel_imu, *reading.gyro_imu))


async def samples(imu: Imu) -> list[str]:
    return [sample_command(reading) for reading in await imu.read()]


async def echoes(sensor: DepthSensor) -> list[str]:
    try:
        return [echo_command(await sensor.measure())]
    except HardwareError:  # what the simulated one has lost, the emulated one does not hear
        await asyncio.sleep(RETRY_S)
        return ["range mute"]


def echo_command(depth: CapturedDepth) -> str:
    """The board's command that puts the nearest thing before its HC-SR04."""
    millimetres = cv2.imdecode(np.frombuffer(depth.png, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    assert millimetres is not None
    return f"range echo {2e3 * int(millimetres[0, 0]) / SOUND_M_S:.0f}"


def open_emulated(base: DeviceSet) -> DeviceSet:
    """Puts the emulated Mega before another robot's IMU and motors.

    Args:
        base: the (simulated) robot that moves and measures; without IMU one at rest.
    Raises:
        DeviceUnavailable: the board is not built.
    """
    geometry = DriveGeometry()

    def move(left: int, right: int) -> None:
        if base.motors is not None:
            base.motors.drive(*geometry.velocity(left, right), UNTIL_PINS_CHANGE_NS)

    board = EmulatedBoard(on_pins=move, keep_events=100)  # nobody asks for more than the first
    try:
        board.command("sample 0 0 9.81 0 0 0")
        told = base.calibration.depth_sensor
        sonar = base.depth if told is not None and told.is_cone else None
        mega = Mega(
            lambda: PySerialLine(str(board.port)),
            ConfigImu(),
            ConfigMotors(cutoff_mv=6400),
            range_sensor=None if sonar is None else PERIOD,
        )
    except BaseException:
        board.close()
        raise
    feeders = [] if base.imu is None else [Feeder(partial(samples, base.imu), board)]
    depth = base.depth
    if sonar is not None:
        feeders.append(Feeder(partial(echoes, sonar), board))
        depth = HcSr04(mega)
    imu, motors = EmulatedImu(mega, board, feeders), MegaMotors(mega, geometry)
    battery = MegaBattery(mega, 6.4, 8.4)
    return dataclasses.replace(base, imu=imu, motors=motors, depth=depth, battery=battery, problems=mega.problems)


__all__ = ["EmulatedBoard", "open_emulated"]
