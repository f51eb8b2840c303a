"""What robot-server tells systemd, on a real datagram socket."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robot.config import RobotConfig, ServerConfig
from robot.devices.ports import DeviceSet
from robot.server import RobotServer
from robot.systemd import FEEDS_PER_PERIOD, Systemd
from robot.watchdog import Velocity
from shared.calibration import REFERENCE_ROBOT
from shared.listening import bind
from tests.support.paths import ROOT

WAIT_S = 60.0
PERIOD_US = 200_000


class Manager:
    """The service manager's end of NOTIFY_SOCKET."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.setblocking(False)

    def told(self) -> list[str]:
        """All that has come since the last call."""
        found = []
        while True:
            try:
                found.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                return found

    async def hear(self, wanted: str) -> list[str]:
        """Wait until this is said; everything said until then."""
        heard: list[str] = []
        async with asyncio.timeout(WAIT_S):
            while wanted not in heard:
                heard += self.told()
                await asyncio.sleep(0.01)
        return heard


@pytest.fixture(params=["path", "name"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return str(tmp_path / "notify") if request.param == "path" else f"@sentinel-test-{os.getpid()}"


@pytest.fixture
def manager(address: str) -> Iterator[Manager]:
    manager = Manager(address)
    yield manager
    manager.socket.close()


def test_ready_is_said_once_and_the_watchdog_is_fed_in_time(address: str, manager: Manager) -> None:
    systemd = Systemd.of({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000000"})
    systemd.ready()
    for ms in range(0, 1000, 50):
        systemd.alive(ms * 1_000_000)
    systemd.ending()
    assert manager.told() == ["READY=1", *["WATCHDOG=1"] * FEEDS_PER_PERIOD, "STOPPING=1"]


def test_without_systemd_and_with_another_process_watchdog_nothing_is_fed(address: str, manager: Manager) -> None:
    for environment in (
        {},
        {"NOTIFY_SOCKET": address},
        {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1"},
        {"NOTIFY_SOCKET": "/no/such/socket", "WATCHDOG_USEC": "1000"},
    ):
        systemd = Systemd.of(environment)
        for ms in range(100):
            systemd.alive(ms * 1_000_000)
    assert manager.told() == []


async def test_the_program_says_ready_alive_and_ending(address: str, manager: Manager, tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    (folder / "camera.yaml").write_text("resolution: [64, 48]\nintrinsics: [60.0, 60.0, 32.0, 24.0]\nrate_hz: 30\n")
    (folder / "frame.jpg").write_bytes(b"never read: no station comes")
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "robot.main", "--devices", "recorded", "--dataset", str(folder), "--port", "0"),
        cwd=ROOT,
        env={**os.environ, "NOTIFY_SOCKET": address, "WATCHDOG_USEC": str(PERIOD_US)},
        stdout=asyncio.subprocess.DEVNULL,
    )
    try:
        assert (await manager.hear("READY=1"))[0] == "READY=1"
        for _ in range(3):
            await manager.hear("WATCHDOG=1")
        process.send_signal(signal.SIGTERM)
        await manager.hear("STOPPING=1")
        assert await asyncio.wait_for(process.wait(), WAIT_S) == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


class HangingMotors:
    """A driver whose next command does not return until it is let go."""

    def __init__(self) -> None:
        self.entered, self.let_go = threading.Event(), threading.Event()

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        self.entered.set()
        self.let_go.wait(WAIT_S)

    def stop(self) -> str:
        return ""

    def close(self) -> None: ...


@pytest.mark.parametrize("what", ["the motors' guard hangs", "the loop is blocked"])
async def test_systemd_is_not_told_that_it_lives_when_it_does_not(address: str, manager: Manager, what: str) -> None:
    motors = HangingMotors()
    devices = DeviceSet(calibration=REFERENCE_ROBOT, camera=None, imu=None, motors=motors)
    config = RobotConfig(server=ServerConfig(port=0))
    server = RobotServer(devices, config, systemd=Systemd(address, PERIOD_US))
    assert server.watchdog is not None
    serving = asyncio.create_task(server.serve(bind("127.0.0.1", 0)))
    try:
        await manager.hear("WATCHDOG=1")
        if what == "the loop is blocked":
            manager.told()
            time.sleep(2 * PERIOD_US * 1e-6)  # this is the fault
            assert manager.told() == []
        else:
            server.watchdog.command(Velocity(0.1, 0.0), time.monotonic_ns() + 10**9)
            await asyncio.to_thread(motors.entered.wait, WAIT_S)
            async with asyncio.timeout(WAIT_S):
                while server.watchdog.is_working:
                    await asyncio.sleep(0.01)
            manager.told()
            await asyncio.sleep(2 * PERIOD_US * 1e-6)
            assert manager.told() == []
            motors.let_go.set()
        await manager.hear("WATCHDOG=1")  # works again, is fed again
    finally:
        motors.let_go.set()
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
