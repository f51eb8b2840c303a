"""Robots and stations with access control, on loopback, with real TLS."""

from __future__ import annotations

import asyncio
import datetime
import ssl
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

import websockets

from robot.access import Gate
from robot.server import RobotServer
from shared.access import Role, Token, prove
from shared.certificates import make_identity
from shared.framing import MAX_STATION_PAYLOAD, encode_payload
from shared.listening import bind
from shared.message_codec import encode_message
from shared.messages import (
    PROTOCOL_VERSION,
    CalibrationChanged,
    Datagrams,
    DriveApplied,
    ErrorNotice,
    Hello,
    Join,
    Message,
    Paired,
    PairReply,
    Prove,
    Refusal,
    Welcome,
)
from shared.session import Session
from shared.token_book import TokenBook
from station.access.connecting import Connection, connect_by_tls
from station.access.paired_robots import PairedRobot, PairedRobots
from station.robots.link import RobotLink
from tests.support.link import Bench, HearingDesk, Notes, ServerOptions
from tests.support.station import Desk, running_station

JOIN = Join(protocol=PROTOCOL_VERSION, station_name="desk", knows_calibration_changed=True)
NOW = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)


def set_up(folder: Path) -> Path:
    """Key, certificate and an empty book."""
    TokenBook.create(folder)
    make_identity(folder, "test", ["localhost", "127.0.0.1"], 3650, NOW)
    return folder


class GuardedBench(Bench):
    """A robot-server with fake devices and access control."""

    def __init__(self, folder: Path, **server: Unpack[ServerOptions]) -> None:
        super().__init__(1.0, **server)
        self.folder = folder

    async def start(self) -> None:
        await self.start_with(Gate(self.folder))

    async def start_with(self, gate: Gate) -> None:
        self.gate = gate
        listener = bind("127.0.0.1", self.port)
        self.port = listener.getsockname()[1]
        self._server = RobotServer(self.devices(), self.config, gate=gate)
        desk = self.server.desk
        self.server.desk = HearingDesk(desk.devices, desk.watchdog, desk.limits, heard=self.heard)
        self.task = asyncio.create_task(self.server.serve(listener))

    def admit(self, name: str, role: Role, robots: PairedRobots) -> str:
        """Make a token by hand and give it to a station; returns the token."""
        book = TokenBook(self.folder)
        text = book.add(name, role, self.gate.now_s()).text
        robots.store(
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
async def guarded_robot(folder: Path, **server: Unpack[ServerOptions]) -> AsyncIterator[GuardedBench]:
    bench = GuardedBench(set_up(folder), **server)
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


class Talk:
    """A station that says whatever a test wants, in whatever order."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._session = Session("station", 0)

    def say(self, message: Message) -> None:
        self.say_bytes(encode_payload(encode_message(message), MAX_STATION_PAYLOAD))

    def say_bytes(self, data: bytes) -> None:
        self.connection.writer.write(data)

    async def hear(self) -> Message | None:
        """The next message that is not a report; None: the robot closed."""
        return await self._hear(Hello, Welcome, Refusal, CalibrationChanged, Datagrams, ErrorNotice, PairReply, Paired)

    async def hear_report(self) -> Message | None:
        """The next report of what the motors do, or the last word; None: the robot closed."""
        return await self._hear(DriveApplied, Refusal, ErrorNotice)

    async def _hear(self, *kinds: type[Message]) -> Message | None:
        while True:
            message = self._session.next_message(0)
            if isinstance(message, kinds):
                return message
            if message is None:
                try:
                    data = await asyncio.wait_for(self.connection.reader.read(65536), 10)
                except ConnectionError:
                    return None
                if not data:
                    return None
                self._session.receive(data)

    async def hear_hello(self) -> Hello:
        hello = await self.hear()
        assert isinstance(hello, Hello)
        return hello

    def prove(self, token: Token, hello: Hello) -> Prove:
        return Prove(token_id=token.id, proof=prove(token, hello.challenge, self.connection.fingerprint))


@asynccontextmanager
async def talking(bench: GuardedBench) -> AsyncIterator[Talk]:
    talk = Talk(await connect_by_tls("127.0.0.1", bench.port))
    try:
        yield talk
    finally:
        talk.connection.writer.transport.abort()


@asynccontextmanager
async def linked(port: int, robots: PairedRobots | None) -> AsyncIterator[tuple[RobotLink, Notes]]:
    """A link that may or may not get connected."""
    notes = Notes()
    link = RobotLink("127.0.0.1", port, notes, robots=robots)
    task = asyncio.create_task(link.run())
    try:
        yield link, notes
    finally:
        assert not task.done(), "the link ended by itself"
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def make_token(bench: GuardedBench, role: Role, name: str = "desk") -> Token:
    return TokenBook(bench.folder).add(name, role, time.time())
