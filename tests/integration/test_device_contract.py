"""What every set of devices must do, whichever hardware is behind it. Further adapters add a row to ADAPTERS."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

import cv2
import msgspec
import numpy as np
import pytest
import pytest_asyncio

from robot.config import PiConfig, load_config
from robot.devices.emulated import EmulatedBoard, EmulatedImu, open_emulated
from robot.devices.pi import gpio_parts, open_pi
from robot.devices.pi.hc_sr04 import HcSr04, calibration_of
from robot.devices.ports import Camera, CapturedDepth, CapturedFrame, DepthSensor, DeviceSet, Imu, ImuReading
from robot.devices.recorded import open_recorded
from robot.devices.simulated import open_simulated
from robot.simulation.config import SimulationConfig
from robot.simulation.recording import record_drive
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from shared.calibration import REFERENCE_ROBOT
from shared.errors import DeviceLost
from shared.pictures import depth_png
from tests.support import mock_gpio, pi_stubs
from tests.support.emulator import board

WAIT_S = 90.0  # generous: a loaded machine must not fail a test
SETTINGS = Path("/etc/sentinel/robot.toml")  # of a real robot, whichever way it is wired


@dataclass
class Bench:
    """Where devices are opened, and what can be seen of the motors from outside."""

    folder: Path
    undo: ExitStack
    drive: Path  # a recording, of whoever makes it first
    turning: Callable[[], bool] | None = None  # whether the motor pins turn anything; None: nobody can see it


def simulated(_bench: Bench) -> DeviceSet:
    return open_simulated("room", 1)


def emulated(_bench: Bench) -> DeviceSet:
    """IMU, motors and battery through the real firmware in an emulated Mega."""
    if (reason := board.missing_reason()) is not None:
        pytest.skip(reason)
    board.build()
    return open_emulated(DeviceSet(calibration=REFERENCE_ROBOT, camera=None, imu=None, motors=None))


def install_stubs(bench: Bench) -> None:
    pi_stubs.install()
    bench.undo.callback(pi_stubs.uninstall)


def pi_stubbed(bench: Bench) -> DeviceSet:
    """The real robot's adapters: emulated Mega, stand-ins for the vendors' Python modules."""
    if (reason := board.missing_reason()) is not None:
        pytest.skip(reason)
    board.build()
    mega = EmulatedBoard()
    bench.undo.callback(mega.close)
    mega.command("sample 0 0 9.81 0 0 0")
    bench.turning = lambda: mega.pins != (0, 0)
    install_stubs(bench)
    return open_pi(PiConfig(serial_port=str(mega.port)))


def pi_gpio_stubbed(bench: Bench) -> DeviceSet:
    """The other wiring: motors and servos on the Pi's own pins, the battery at an INA219, no Mega."""
    pytest.importorskip("gpiozero")
    log = bench.folder / "pins"
    config = PiConfig(imu=False, motors="gpio", pan_tilt="gpio", battery="ina219")
    bench.turning = lambda: any(mock_gpio.states(log).get(pin, 0.0) for pin in config.gpio_pins[:4])
    patch = pytest.MonkeyPatch()
    bench.undo.callback(patch.undo)
    patch.setattr(gpio_parts, "PROGRAM", [sys.executable, "-m", "tests.support.mock_gpio", str(log)])
    install_stubs(bench)
    return open_pi(config)


def pi_real(_bench: Bench) -> DeviceSet:
    return open_pi(load_config(SETTINGS if SETTINGS.exists() else None, {}).pi)


def recorded(bench: Bench) -> DeviceSet:
    if not bench.drive.exists():
        world = make_world("room", 1)
        record_drive(world, plan_route(world, "triangle_a"), SimulationConfig(), 0, bench.drive, max_duration_s=2.0)
    return open_recorded(bench.drive, at_end="loop")


ADAPTERS: dict[str, Callable[[Bench], DeviceSet]] = {
    "simulated": simulated,
    "recorded": recorded,
    "emulated": emulated,
    "pi_stubbed": pi_stubbed,
    "pi_gpio_stubbed": pi_gpio_stubbed,
    "pi": pi_real,
}
PARAMETERS = [pytest.param(name, marks=[pytest.mark.hardware] if name == "pi" else []) for name in ADAPTERS]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recorded") / "drive"


@pytest.fixture
def bench(tmp_path: Path, drive: Path) -> Iterator[Bench]:
    with ExitStack() as undo:
        yield Bench(tmp_path, undo, drive)


@pytest_asyncio.fixture(params=PARAMETERS)
async def devices(request: pytest.FixtureRequest, bench: Bench) -> AsyncIterator[DeviceSet]:
    opened = ADAPTERS[request.param](bench)
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
    # Not the mean: the first arrivals may have been slow, and a quicker one moves the clock.
    assert median(steps) == pytest.approx(1e9 / noise.rate_hz, rel=0.02)


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
    motors.drive(0.1, -0.5, soon_ns())
    await asyncio.to_thread(motors.stop)
    motors.close()
    motors.stop()  # also after closing, without raising


def soon_ns() -> int:
    return time.monotonic_ns() + 250_000_000


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(WAIT_S):
        while not condition():
            await asyncio.sleep(0.005)


async def test_motors_rest_until_driven_and_stop_by_word_and_by_silence(devices: DeviceSet, bench: Bench) -> None:
    motors, turning = devices.motors, bench.turning
    if motors is None or turning is None:
        pytest.skip("nobody sees these devices' motors from outside")
    assert not turning()
    for end in (motors.stop, lambda: None):
        while not turning():  # said again and again, as robot-server does: a busy machine may pass over one
            with contextlib.suppress(DeviceLost):  # a starved emulator may be silent for half a second
                motors.drive(0.3, 0.0, soon_ns())
            await asyncio.sleep(0.05)
        end()
        await until(lambda: not turning())


async def test_a_command_that_comes_after_its_end_moves_nothing(devices: DeviceSet, bench: Bench) -> None:
    motors, turning = devices.motors, bench.turning
    if motors is None or turning is None:
        pytest.skip("nobody sees these devices' motors from outside")
    while not turning():
        with contextlib.suppress(DeviceLost):
            motors.drive(0.3, 0.0, soon_ns())
        await asyncio.sleep(0.05)
    late_ns = time.monotonic_ns()
    while turning():  # the last command in time ends; late ones do not keep it up
        with contextlib.suppress(DeviceLost):
            motors.drive(0.3, 0.0, late_ns)
        await asyncio.sleep(0.05)
    for _ in range(10):
        with contextlib.suppress(DeviceLost):
            motors.drive(0.3, 0.0, late_ns)
        await asyncio.sleep(0.05)
        assert not turning()


async def test_the_head_points_and_lets_go_in_any_order(devices: DeviceSet) -> None:
    if devices.pan_tilt is None:
        pytest.skip("these devices have no pan-tilt")
    for pan, tilt in ((0.5, 0.0), (-10.0, 10.0), (0.0, 0.0)):  # beyond its reach is its end
        devices.pan_tilt.point(pan, tilt)
    devices.pan_tilt.close()
    devices.pan_tilt.close()


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


async def test_an_emulated_robot_tells_what_its_mega_complains_of(tmp_path: Path, drive: Path) -> None:
    with ExitStack() as undo:
        devices = emulated(Bench(tmp_path, undo, drive))
        assert isinstance(devices.imu, EmulatedImu)
        try:
            await until(lambda: devices.problems() == {})  # the chip is being set up at first
            devices.imu.board.command("imu_unplug")
            await until(lambda: "IMU_MISSING" in devices.problems())
            assert "ICM-20948" in devices.problems()["IMU_MISSING"]
        finally:
            assert devices.motors is not None
            devices.motors.close()
            await devices.imu.close()


async def test_a_simulated_range_goes_through_the_firmware_of_the_emulated_mega(tmp_path: Path) -> None:
    """World → echo at the emulated sensor → real firmware → serial line → adapter: the same distance."""
    if (reason := board.missing_reason()) is not None:
        pytest.skip(reason)
    board.build()
    sonar = PlayedDepth()
    calibration = msgspec.structs.replace(REFERENCE_ROBOT, depth=calibration_of((0.2, 0.0, 0.0)))
    devices = open_emulated(DeviceSet(calibration=calibration, camera=None, imu=None, motors=None, depth=sonar))
    assert isinstance(devices.depth, HcSr04) and devices.imu is not None
    try:
        for millimetres in (300, 1500, 0, 3500):
            sonar.millimetres = millimetres
            await until(lambda m=millimetres: sonar.given >= 2 and sonar.last == m)  # it hangs before the sensor
            for _ in range(2):  # begun before that, at most
                with contextlib.suppress(DeviceLost):  # nothing was plugged in yet
                    await devices.depth.measure()
            depth = await devices.depth.measure()
            [[found]] = cv2.imdecode(np.frombuffer(depth.png, np.uint8), cv2.IMREAD_UNCHANGED).tolist()
            assert found == pytest.approx(millimetres, rel=0.005, abs=1)
        sonar.is_broken = True
        await until(lambda: sonar.given == 0)
        with pytest.raises(DeviceLost, match="does not answer"):
            await asyncio.wait_for(_measure_on(devices.depth), WAIT_S)
    finally:
        await devices.imu.close()


async def _measure_on(sensor: DepthSensor) -> None:
    while True:
        await sensor.measure()


class PlayedDepth:
    """A sensor before which a test puts something."""

    def __init__(self) -> None:
        self.millimetres = self.last = 1000
        self.given = 0
        self.is_broken = False

    async def measure(self) -> CapturedDepth:
        await asyncio.sleep(0.02)
        if self.is_broken:
            self.given = 0
            raise DeviceLost("broken")
        if self.last != self.millimetres:
            self.given, self.last = 0, self.millimetres
        self.given += 1
        return CapturedDepth(time.monotonic_ns(), depth_png(np.array([[self.last]], dtype=np.uint16)))

    async def close(self) -> None: ...
