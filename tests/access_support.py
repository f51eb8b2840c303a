"""Robots and stations with access control, on loopback, with real TLS."""

from __future__ import annotations

import asyncio
import datetime
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import websockets

from robot.access import Gate
from robot.server import RobotServer
from shared.access import Role
from shared.certificates import make_identity
from shared.listening import bind
from shared.token_book import TokenBook
from station.paired_robots import PairedRobot, PairedRobots
from tests.link_support import Bench, HearingDesk
from tests.station_support import Desk, running_station

NOW = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)


def set_up(folder: Path) -> Path:
    """Key, certificate and an empty book."""
    TokenBook.create(folder)
    make_identity(folder, "test", ["localhost", "127.0.0.1"], 3650, NOW)
    return folder


class GuardedBench(Bench):
    """A robot-server with fake devices and access control."""

    def __init__(self, folder: Path, **server: int) -> None:
        super().__init__(1.0, **server)
        self.folder = folder

    async def start(self) -> None:
        await self.start_with(Gate(self.folder))

    async def start_with(self, gate: Gate) -> None:
        self.gate = gate
        listener = bind("127.0.0.1", self.port)
        self.port = listener.getsockname()[1]
        self.server = RobotServer(self.devices(), self.config, gate=gate)
        desk = self.server.desk
        self.server.desk = HearingDesk(desk.devices, desk.watchdog, desk.limits, heard=self.heard)
        self.task = asyncio.create_task(self.server.serve(listener))

    def admit(self, name: str, role: Role, robots: PairedRobots) -> str:
        """Make a token by hand and give it to a station; returns the token."""
        book = TokenBook(self.folder)
        text = book.add(name, role, self.gate.now_s()).text
        robots.keep(
            PairedRobot(
                robot_id="r",
                name="Robot",
                host="127.0.0.1",
                port=self.port,
                fingerprint=self.gate.fingerprint.hex(),
                token=text,
            )
        )
        return text


@asynccontextmanager
async def guarded_robot(folder: Path) -> AsyncIterator[GuardedBench]:
    bench = GuardedBench(set_up(folder))
    await bench.start()
    try:
        yield bench
    finally:
        assert bench.task is None or not bench.task.done(), "robot-server ended by itself"
        await bench.stop()


@dataclass
class Guarded:
    """A station with access control, and a token of each role."""

    desk: Desk
    tokens: dict[Role, str]
    context: ssl.SSLContext
    folder: Path

    def headers(self, role: Role | None) -> dict[str, str]:
        return {} if role is None else {"Authorization": f"Bearer {self.tokens[role]}"}

    @property
    def origin(self) -> str:
        return self.desk.address

    def socket(self, path: str, **options: Any) -> websockets.connect:
        return websockets.connect(self.desk.socket(path), ssl=self.context, **options)


@asynccontextmanager
async def guarded_station(tmp_path: Path, robot_port: int = 1) -> AsyncIterator[Guarded]:
    folder = set_up(tmp_path / "access")
    book = TokenBook(folder)
    tokens = {role: book.add(f"{role.value}er", role, 0.0).text for role in Role}
    context = ssl.create_default_context(cafile=str(folder / "certificate.pem"))
    async with running_station(robot_port, tmp_path, verify=context) as desk:
        yield Guarded(desk, tokens, context, folder)
