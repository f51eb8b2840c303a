"""A simulated robot whose IMU and motors go through the real firmware in an emulated Mega.

The simulated IMU's readings become the emulated chip's registers; the duty at the emulated motor pins moves the
simulated body. Between them runs everything the real robot runs: firmware, serial line, Pi adapters.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import threading

from robot.devices.emulated.board import EmulatedBoard
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.pi.mega import Mega
from robot.devices.pi.mega_parts import MegaBattery, MegaImu, MegaMotors
from robot.devices.pi.serial_line import PySerialLine
from robot.devices.ports import DeviceSet, Imu, ImuReading
from shared.errors import DeviceLost
from shared.serial_protocol import ConfigImu, ConfigMotors

UNTIL_PINS_CHANGE_NS = 2**63 - 1  # a pin holds its level: it is the firmware that ends a motion


class EmulatedImu(MegaImu):
    """The emulated Mega's IMU; closing it ends the board and the feeding."""

    def __init__(self, mega: Mega, board: EmulatedBoard, feeder: Feeder | None) -> None:
        super().__init__(mega)
        self.board, self._feeder = board, feeder

    async def close(self) -> None:
        await super().close()
        if self._feeder is not None:
            self._feeder.close()
        self.board.close()


class Feeder:
    """Moves the readings of another IMU into the emulated chip, in a thread with an event loop of its own."""

    def __init__(self, source: Imu, board: EmulatedBoard) -> None:
        self._source, self._board = source, board
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, name="imu-feeder", daemon=True)
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
            for reading in await self._source.read():
                try:
                    self._board.command(sample_command(reading))
                except DeviceLost:
                    return


def sample_command(reading: ImuReading) -> str:
    """The board's command that puts a reading into the chip."""
    return "sample " + " ".join(f"{v:.6g}" for v in (*reading.accel_imu, *reading.gyro_imu))


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
        mega = Mega(lambda: PySerialLine(str(board.port)), ConfigImu(), ConfigMotors(cutoff_mv=6400))
    except BaseException:
        board.close()
        raise
    feeder = None if base.imu is None else Feeder(base.imu, board)
    imu, motors = EmulatedImu(mega, board, feeder), MegaMotors(mega, geometry)
    battery = MegaBattery(mega, 6.4, 8.4)
    return dataclasses.replace(base, imu=imu, motors=motors, battery=battery, problems=mega.problems)


__all__ = ["EmulatedBoard", "open_emulated"]
