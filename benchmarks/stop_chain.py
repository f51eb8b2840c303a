"""One whole chain: page (WebSocket) → station → network (a proxy that can be cut) → robot-server → emulated Mega."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import websockets

from robot.devices.emulated import EmulatedBoard

ROOT = Path(__file__).parents[1]
START_TIMEOUT_S = 90.0
REPEAT_S = 0.05  # as the page does while the joystick is held


class Cable:
    """TCP proxy between station and robot-server. Cut, it keeps both connections open and carries nothing."""

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
        self.holds = False
        self.refused = 0

    async def open(self) -> None:
        self._socket = await websockets.connect(f"{self._address}/ws/drive?driver={self._name}")
        self._tasks = [asyncio.create_task(self._hold(self._socket)), asyncio.create_task(self._hear(self._socket))]

    async def _hold(self, socket: websockets.ClientConnection) -> None:
        seq = 0
        with contextlib.suppress(websockets.ConnectionClosed):
            while True:
                if self.holds:
                    seq += 1
                    command = {"type": "drive", "seq": seq, "linear": self._linear, "angular": 0.0, "ttl_ms": 250}
                    await socket.send(json.dumps(command))
                await asyncio.sleep(REPEAT_S)

    async def _hear(self, socket: websockets.ClientConnection) -> None:
        with contextlib.suppress(websockets.ConnectionClosed):
            async for answer in socket:
                self.refused += json.loads(answer)["type"] == "refused"

    def vanish(self) -> None:
        """The tab is closed: the connection ends without a word."""
        self.holds = False
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
        self.cable = Cable()
        self.motor_log = self.folder / "motors"
        self.robot: asyncio.subprocess.Process | None = None
        self.station: asyncio.subprocess.Process | None = None
        self.page: Page | None = None
        self.address = ""

    async def start(self) -> None:
        await self.cable.start()
        await self.start_robot()
        await self.start_station()
        await self.open_page()

    async def start_robot(self) -> None:
        command = [sys.executable, "-m", "benchmarks.stop_robot", "--serial", str(self.board.port)]
        self.robot = await self._spawn([*command, "--log", str(self.motor_log)], stdin=True)
        self.cable.target = int((await self._line(self.robot, "port ")).split()[1])

    async def start_station(self) -> None:
        command = [sys.executable, "-m", "station.main", "serve", "--robot", f"127.0.0.1:{self.cable.port}"]
        self.station = await self._spawn([*command, "--port", "0", "--data", str(self.folder / "data")])
        line = await self._line(self.station, "station: page")
        self.address = line.split()[-1].replace("http://", "ws://")

    async def open_page(self) -> None:
        self.page = Page(self.address, "driver", 0.3)
        await self.page.open()

    async def tell_robot(self, line: str) -> None:
        """A fault for benchmarks/stop_robot.py."""
        assert self.robot is not None and self.robot.stdin is not None
        self.robot.stdin.write(line.encode() + b"\n")
        await self.robot.stdin.drain()

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

    def pins_zero_ns(self, since_ns: int) -> int | None:
        """When the pins went to zero for good since a time (our clock); None while they move."""
        if self.board.pins != (0, 0):
            return None
        last = since_ns
        for event in reversed(list(self.board.events)):
            if event.t_ns < since_ns:
                break
            if event.text.startswith("pins ") and event.text != "pins 0 0":
                break
            if event.text == "pins 0 0":
                last = event.t_ns
        return last

    def slips_between(self, start_ns: int, end_ns: int) -> int:
        """How often the board had to give up real time because this PC was busy."""
        events = list(self.board.events)
        return sum(e.text.startswith("slip ") and start_ns <= e.t_ns <= end_ns for e in events)

    def server_stop_ns(self, since_ns: int) -> int | None:
        """When robot-server told the motors to stop for good since a time; None while it has not."""
        calls = [line.split() for line in self.motor_log.read_text().splitlines()[-400:] if line.count(" ") == 1]
        drives = [int(t) for t, what in calls if what == "drive"]
        after = max([since_ns, *drives])
        stops = [int(t) for t, what in calls if what == "stop" and int(t) > after]
        if stops:
            return stops[0]
        # It may have stood already when the fault came.
        return since_ns if calls and calls[-1][1] == "stop" else None

    async def close(self) -> None:
        if self.page is not None:
            await self.page.close()
        for process in (self.station, self.robot):
            if process is not None:
                await self.kill(process)
        await self.cable.close()
        self.board.close()
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

    async def _spawn(self, command: list[str], stdin: bool = False) -> asyncio.subprocess.Process:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
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
