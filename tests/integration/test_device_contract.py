"""What every set of devices must do, whichever hardware is behind it. Further adapters add a row to ADAPTERS."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import pytest
import pytest_asyncio

from robot.config import PiConfig
from robot.devices.emulated import EmulatedBoard, open_emulated
from robot.devices.pi import open_pi
from robot.devices.ports import Camera, CapturedFrame, DeviceSet, Imu, ImuReading
from robot.devices.recorded import open_recorded
from robot.devices.simulated import open_simulated
from robot.simulation.config import SimulationConfig
from robot.simulation.recording import record_drive
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from tests import pi_stubs
from tests.emulator import board

WAIT_S = 60.0  # generous: a loaded machine must not fail a test


def simulated(_tmp_path: Path, _undo: ExitStack) -> DeviceSet:
    return open_simulated("room", 1)


def emulated(_tmp_path: Path, _undo: ExitStack) -> DeviceSet:
    """IMU, motors and battery through the real firmware in an emulated Mega."""
    if (reason := board.missing_reason()) is not None:
        pytest.skip(reason)
    board.build()
    return open_emulated()


def pi_stubbed(_tmp_path: Path, undo: ExitStack) -> DeviceSet:
    """The real robot's adapters: emulated Mega, stand-ins for the vendors' Python modules."""
    if (reason := board.missing_reason()) is not None:
        pytest.skip(reason)
    board.build()
    mega = EmulatedBoard()
    undo.callback(mega.close)
    mega.command("sample 0 0 9.81 0 0 0")
    pi_stubs.install()
    undo.callback(pi_stubs.uninstall)
    return open_pi(PiConfig(serial_port=str(mega.port)))


def pi_real(_tmp_path: Path, _undo: ExitStack) -> DeviceSet:
    return open_pi(PiConfig())


def recorded(tmp_path: Path, _undo: ExitStack) -> DeviceSet:
    world = make_world("room", 1)
    record_drive(world, plan_route(world, "triangle_a"), SimulationConfig(), 0, tmp_path / "drive", max_duration_s=2.0)
    return open_recorded(tmp_path / "drive", at_end="loop")


ADAPTERS: dict[str, Callable[[Path, ExitStack], DeviceSet]] = {
    "simulated": simulated,
    "recorded": recorded,
    "emulated": emulated,
    "pi_stubbed": pi_stubbed,
    "pi": pi_real,
}
PARAMETERS = [pytest.param(name, marks=[pytest.mark.hardware] if name == "pi" else []) for name in ADAPTERS]


@pytest_asyncio.fixture(params=PARAMETERS)
async def devices(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[DeviceSet]:
    with ExitStack() as undo:
        opened = ADAPTERS[request.param](tmp_path, undo)
        yield opened
        if opened.motors is not None:
            opened.motors.close()
        for part in (opened.camera, opened.imu):
            if part is not None:
                await part.close()


async def take_frames(camera: Camera, count: int) -> list[CapturedFrame]:
    return [await asyncio.wait_for(camera.capture(), WAIT_S) for _ in range(count)]


async def take_readings(imu: Imu, count: int) -> list[ImuReading]:
    readings: list[ImuReading] = []
    while len(readings) < count:
        readings += await asyncio.wait_for(imu.read(), WAIT_S)
    return readings


async def test_frames_are_jpegs_of_the_calibrated_size_in_time_order(devices: DeviceSet) -> None:
    camera, calibration = devices.camera, devices.calibration.camera
    if camera is None or calibration is None:
        pytest.skip("these devices have no camera")
    frames = await take_frames(camera, 4)
    for frame in frames:
        assert frame.jpeg.startswith(b"\xff\xd8") and frame.jpeg.endswith(b"\xff\xd9")
        assert (frame.width, frame.height) == (calibration.width, calibration.height)
        assert frame.exposure_ns >= 0
    times = [f.t_robot_ns for f in frames]
    assert times == sorted(set(times))


async def test_imu_counts_every_sample_and_stamps_them_at_its_rate(devices: DeviceSet) -> None:
    imu, noise = devices.imu, devices.calibration.imu
    if imu is None or noise is None:
        pytest.skip("these devices have no IMU")
    readings = await take_readings(imu, 200)
    assert {b.sequence - a.sequence for a, b in pairwise(readings)} == {1}
    steps = [b.t_robot_ns - a.t_robot_ns for a, b in pairwise(readings)]
    assert min(steps) > 0
    assert sum(steps) / len(steps) == pytest.approx(1e9 / noise.rate_hz, rel=0.02)


async def test_imu_delivers_what_came_while_nobody_asked(devices: DeviceSet) -> None:
    if devices.imu is None:
        pytest.skip("these devices have no IMU")
    last = (await take_readings(devices.imu, 1))[-1]
    while devices.clock() - last.t_robot_ns < 300_000_000:  # a reader that was busy for a while
        await asyncio.sleep(0.02)
    batch = await asyncio.wait_for(devices.imu.read(), WAIT_S)
    assert batch[0].sequence == last.sequence + 1
    assert 1 < len(batch) <= 225


async def test_a_waiting_reader_can_be_cancelled_and_the_next_gets_data(devices: DeviceSet) -> None:
    if devices.camera is None:
        pytest.skip("these devices have no camera")
    waiting = asyncio.create_task(devices.camera.capture())
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    assert (await take_frames(devices.camera, 1))[0].jpeg


async def test_motors_accept_commands_and_stop_from_any_thread(devices: DeviceSet) -> None:
    motors = devices.motors
    if motors is None:
        pytest.skip("these devices have no motors")
    motors.drive(0.1, -0.5)
    await asyncio.to_thread(motors.stop)
    motors.close()
    motors.stop()  # also after closing, without raising


async def test_closing_twice_is_harmless(devices: DeviceSet) -> None:
    for _ in range(2):
        for part in (devices.camera, devices.imu):
            if part is not None:
                await part.close()


async def test_battery_is_a_voltage_and_a_share(devices: DeviceSet) -> None:
    if devices.battery is None:
        pytest.skip("these devices have no battery sensor")
    state = devices.battery.read()
    assert 3.0 < state.voltage_v < 13.0 and 0.0 <= state.fraction <= 1.0
