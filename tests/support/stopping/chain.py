"""One whole chain: page (WebSocket) → station → robot-server → emulated Mega; proxies that can be cut lie between."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import websockets

from robot.devices.emulated.board import BoardEvent, EmulatedBoard
from tests.support.paths import ROOT
from tests.support.stopping.clock import SettableClock

START_TIMEOUT_S = 90.0
REPEAT_S = 0.05  # as the page does while the joystick is held


@dataclass(frozen=True, slots=True)
class LineEntry:
    """A line of tests/support/stopping/robot.py's log: stamped before and after (our monotonic clock), and what."""

    before_ns: int
    after_ns: int
    what: str


class Cable:
    """TCP proxy between two programs. Cut, it keeps both connections open and carries nothing."""

    def __init__(self) -> None:
        self.target = 0
        self.is_cut = False
        self._writers: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self.port = 0
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._connect, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """End all connections and stop listening."""
        self.mend()
        if self._server is not None:
            self._server.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self.target)
        except OSError:
            writer.close()
            return
        self._writers |= {writer, far_writer}
        for source, sink in ((reader, far_writer), (far_reader, writer)):
            task = asyncio.create_task(self._carry(source, sink))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await source.read(65536):
                while self.is_cut:
                    await asyncio.sleep(0.005)
                sink.write(data)
                await sink.drain()
        sink.close()

    def mend(self) -> None:
        """A new network: what hung in the old one is gone."""
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()
        for task in self._tasks:
            task.cancel()
        self.is_cut = False


class Page:
    """A browser's page that holds the joystick: repeats its command until told otherwise."""

    def __init__(self, address: str, name: str, linear: float) -> None:
        self._address, self._name, self._linear = address, name, linear
        self._socket: websockets.ClientConnection | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self.is_open = False
        self.holds = False
        self.refused = 0
        self._heard_ms: int | None = None  # as the page repeats it

    async def open(self) -> None:
        self._socket = await websockets.connect(f"{self._address}/ws/drive?driver={self._name}")
        self.is_open = True
        self._tasks = [asyncio.create_task(self._hold(self._socket)), asyncio.create_task(self._hear(self._socket))]

    async def _hold(self, socket: websockets.ClientConnection) -> None:
        seq = 0
        with contextlib.suppress(websockets.ConnectionClosed):
            while True:
                if self.holds:
                    seq += 1
                    command = {"type": "drive", "seq": seq, "linear": self._linear, "angular": 0.0, "ttl_ms": 250}
                    await socket.send(json.dumps({**command, "heard_ms": self._heard_ms}))
                await asyncio.sleep(REPEAT_S)

    async def _hear(self, socket: websockets.ClientConnection) -> None:
        with contextlib.suppress(websockets.ConnectionClosed):
            async for answer in socket:
                message = json.loads(answer)
                self.refused += message["type"] == "refused"
                if message["type"] == "time":
                    self._heard_ms = message["t_ms"]
        self.is_open = False

    def vanish(self) -> None:
        """The tab is closed: the connection ends without a word."""
        self.holds = self.is_open = False
        if self._socket is not None:
            self._socket.transport.abort()

    async def close(self) -> None:
        self.vanish()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


class Chain:
    """Everything from the page to the motor pins, restartable part by part."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="sentinel-stop-")
        self.folder = Path(self._folder.name)
        self.board = EmulatedBoard(folder=self.folder)
        self.board.command("sample 0 0 9.81 0 0 0")
        self.cable = Cable()  # station to robot-server
        self.page_cable = Cable()  # page to station
        self.clocks = {name: SettableClock(self.folder, name) for name in ("robot", "station")}
        self.hold = self.folder / "hold"
        os.mkfifo(self.hold)
        self._hold_fd = os.open(self.hold, os.O_RDWR)
        self.motor_log = self.folder / "motors"
        self.motor_log.touch()
        self._log_from = 0
        self._marks = 0
        self.robot: asyncio.subprocess.Process | None = None
        self.station: asyncio.subprocess.Process | None = None
        self.page: Page | None = None
        self.address = ""
        self._canary: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        await self.cable.start()
        await self.page_cable.start()
        command = [sys.executable, "-m", "tests.support.stopping.canary", str(self.folder / "canary")]
        self._canary = await self._spawn(command)
        await self.start_robot()
        await self.start_station()
        await self.open_page()

    async def start_robot(self) -> None:
        command = [sys.executable, "-m", "tests.support.stopping.robot", "--serial", str(self.board.port)]
        self.robot = await self._spawn(
            [*command, "--log", str(self.motor_log), "--hold", str(self.hold)], "robot", stdin=True
        )
        self.cable.target = int((await self._line(self.robot, "port ")).split()[1])

    async def start_station(self) -> None:
        command = [sys.executable, "-m", "station.main", "serve", "--robot", f"127.0.0.1:{self.cable.port}"]
        self.station = await self._spawn([*command, "--port", "0", "--data", str(self.folder / "data")], "station")
        line = await self._line(self.station, "station: page")
        self.page_cable.target = int(line.rstrip("/").rpartition(":")[2])
        self.address = f"ws://127.0.0.1:{self.page_cable.port}"

    async def open_page(self) -> None:
        self.page = Page(self.address, "driver", 0.3)
        await self.page.open()

    async def tell_robot(self, line: str) -> None:
        """A fault for tests/support/stopping/robot.py."""
        assert self.robot is not None and self.robot.stdin is not None
        self.robot.stdin.write(line.encode() + b"\n")
        await self.robot.stdin.drain()

    def let_interpreter_go(self) -> None:
        """Ends what `hold` began: robot-server cannot read its stdin meanwhile."""
        os.write(self._hold_fd, b"!")

    async def moving(self, timeout_s: float = START_TIMEOUT_S) -> None:
        """Hold the joystick until the pins turn and have turned for a moment."""
        assert self.page is not None
        self.page.holds = True
        deadline = time.monotonic() + timeout_s
        while min(self.board.pins) < 400:
            if time.monotonic() > deadline:
                raise RuntimeError("the robot does not move")
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.1)

    def forget(self) -> None:
        """Begin a new trial: only what happens from now on counts."""
        self.board.events.clear()
        self._log_from = self.motor_log.stat().st_size

    async def mark(self) -> int:
        """The Mega's time now (us): asked and answered before this returns, so nothing later has an earlier time."""
        self._marks += 1
        text = f"mark {self._marks}"
        self.board.command(text)
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            for event in reversed(list(self.board.events)):
                if event.text == text:
                    return event.t_mega_us
            await asyncio.sleep(0.002)
        raise RuntimeError("the emulated board does not answer")

    async def pass_mega_s(self, seconds: float) -> None:
        """Let this much of the Mega's time go by, however long it takes here."""
        until_us = await self.mark() + seconds * 1e6
        await asyncio.sleep(seconds)
        while await self.mark() < until_us:
            await asyncio.sleep(0.02)

    def events(self) -> list[BoardEvent]:
        """What the board told since `forget`."""
        return list(self.board.events)

    def starved_ms(self, start_ns: int, end_ns: int) -> float:
        """The longest a waiting process had to wait for a core between two of our times."""
        file = self.folder / "canary"
        lines = file.read_text().rpartition("\n")[0].splitlines()[-2000:] if file.exists() else []
        waits = [(int(woken), int(late)) for woken, late in (line.split() for line in lines)]
        return max((late * 1e-6 for woken, late in waits if woken >= start_ns and woken - late <= end_ns), default=0.0)

    def slipped_ms(self, start_ns: int, end_ns: int) -> float:
        """By how much the emulated Mega fell behind the clock between two of our times."""
        slips = [e.text.split() for e in self.events() if start_ns <= e.t_ns <= end_ns]
        return float(sum(int(words[1]) for words in slips if words[0] == "slip"))

    def line_log(self) -> list[LineEntry]:
        """What robot-server wrote to the serial line since `forget`."""
        with self.motor_log.open() as log:
            log.seek(self._log_from)
            whole = log.read().rpartition("\n")[0].splitlines()
        return [LineEntry(int(b), int(a), what) for b, a, what in (line.split() for line in whole)]

    def age_s(self, entry: LineEntry) -> float:
        """How long ago it was written."""
        return (time.monotonic_ns() - entry.before_ns) * 1e-9

    async def logged(self, what: str) -> LineEntry:
        """The first entry of robot-server's log since `forget` that begins so."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            for entry in self.line_log():
                if entry.what.startswith(what):
                    return entry
            await asyncio.sleep(0.005)
        raise RuntimeError(f"robot-server does not log {what!r}")

    async def close(self) -> None:
        if self.page is not None:
            await self.page.close()
        for process in (self.station, self.robot, self._canary):
            if process is not None:
                await self.kill(process)
        for cable in (self.cable, self.page_cable):
            await cable.close()
        self.board.close()
        os.close(self._hold_fd)
        for clock in self.clocks.values():
            clock.close()
        self._folder.cleanup()

    async def kill(self, process: asyncio.subprocess.Process) -> None:
        """End a process and its children for certain."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        await process.wait()

    def complaints(self) -> str:
        """The last of what the programs wrote to stderr."""
        errors = self.folder / "errors"
        return errors.read_text(errors="replace")[-3000:] if errors.exists() else ""

    def signal(self, process: asyncio.subprocess.Process | None, number: int) -> None:
        """To the process and its children: a stopped station means all of it."""
        assert process is not None
        os.killpg(process.pid, number)

    async def _spawn(self, command: list[str], clock: str = "", stdin: bool = False) -> asyncio.subprocess.Process:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        if clock:
            environment |= self.clocks[clock].environment
        with (self.folder / "errors").open("ab") as errors:
            return await asyncio.create_subprocess_exec(
                *command,
                cwd=ROOT,
                env=environment,
                stdin=asyncio.subprocess.PIPE if stdin else asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
            )

    async def _line(self, process: asyncio.subprocess.Process, start: str) -> str:
        assert process.stdout is not None
        while True:
            line = (await asyncio.wait_for(process.stdout.readline(), START_TIMEOUT_S)).decode()
            if not line:
                raise RuntimeError(f"a part of the chain ended instead of saying {start!r}")
            if line.startswith(start):
                return line.strip()
