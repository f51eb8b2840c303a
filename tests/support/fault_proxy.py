"""A wire between station and robot that does what networks do: late, slow, silent, cut, and sometimes rubbish."""

from __future__ import annotations

import asyncio
import random
import socket
from dataclasses import dataclass
from typing import Literal

Direction = Literal["to robot", "to station"]
CHUNK = 65_536


@dataclass
class Faults:
    """What happens to bytes of one direction. Change it while they flow."""

    delay_s: float = 0.0  # every piece comes so much later, in order
    jitter_s: float = 0.0  # up to so much more, still in order: TCP knows no reordering but by a new connection
    bytes_per_s: float = 0.0  # 0: no limit
    is_swallowed: bool = False  # half-open: taken, never delivered, the connection lives
    garbage: float = 0.0  # the share of pieces that get a wrong byte


@dataclass(eq=False)
class _Wire:
    """One relayed connection."""

    ends: tuple[asyncio.StreamWriter, asyncio.StreamWriter]
    is_dead: bool = False  # carries nothing any more, not even an end
    is_mute: bool = False  # the robot hears the station, and not the other way
    directions_ended: int = 0


def _bound(port: int) -> socket.socket:
    bound = socket.socket()
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    bound.bind(("127.0.0.1", port))
    return bound


class FaultProxy:
    """Relays TCP connections to one port. `port` stays the same over cuts."""

    def __init__(self, target_port: int, seed: int = 0) -> None:
        self._target_port = target_port
        self._random = random.Random(seed)
        self._server: asyncio.Server | None = None
        self._held: socket.socket | None = None  # while it is cut
        self._tasks: set[asyncio.Task[None]] = set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._wires: set[_Wire] = set()
        self._flows = asyncio.Event()
        self._flows.set()
        self.port = 0
        self.connections = 0  # taken so far
        self.faults: dict[Direction, Faults] = {"to robot": Faults(), "to station": Faults()}

    async def mend(self) -> None:
        """Take connections from now on."""
        if self._server is not None:
            return
        held, self._held = self._held or _bound(0), None
        self._server = await asyncio.start_server(self._take, sock=held, limit=CHUNK)
        self.port = held.getsockname()[1]

    async def cut(self) -> None:
        """No connection survives, none is taken, until it is mended."""
        if self._server is not None:
            self._server.close()
            self._server = None
            # Not listening, so that connections are refused; but ours, or the system lends it to somebody's connection.
            self._held = _bound(self.port)
        await self.reset()

    async def close(self) -> None:
        """Cut it for good."""
        await self.cut()
        if self._held is not None:
            self._held.close()
            self._held = None

    async def reset(self) -> None:
        """End the connections there are; new ones are taken."""
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()
        wires, tasks = set(self._wires), list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._wires -= wires

    def abandon(self) -> None:
        """The connections there are carry nothing any more, and neither end is told; new ones work.

        So it is when a router that keeps a table of connections starts anew, or a robot loses power for a moment.
        """
        for wire in self._wires:
            wire.is_dead = True

    def mute(self) -> None:
        """The connections there are bring the station nothing any more; what it says still comes, and new ones work.

        When it leaves one of them, the robot is not told: so it is while a network has still to carry what came before.
        """
        for wire in self._wires:
            wire.is_mute = True

    def stall(self) -> None:
        """Bytes stay where they are, connections live."""
        self._flows.clear()

    def flow(self) -> None:
        self._flows.set()

    def heal(self) -> None:
        """No faults from now on."""
        self.faults = {"to robot": Faults(), "to station": Faults()}
        self.flow()

    async def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.add(writer)
        try:
            robot_reader, robot_writer = await asyncio.open_connection("127.0.0.1", self._target_port, limit=CHUNK)
        except OSError:
            writer.transport.abort()
            self._writers.discard(writer)
            return
        self._writers.add(robot_writer)
        wire = _Wire((writer, robot_writer))
        self._wires.add(wire)
        self._relay(wire, reader, robot_writer, "to robot")
        self._relay(wire, robot_reader, writer, "to station")

    def _relay(
        self,
        wire: _Wire,
        source: asyncio.StreamReader,
        sink: asyncio.StreamWriter,
        way: Direction,
    ) -> None:
        queue: asyncio.Queue[tuple[float, bytes] | None] = asyncio.Queue(maxsize=64)
        for coroutine in (self._read(wire, source, queue, way), self._write(wire, sink, queue, way)):
            task = asyncio.create_task(coroutine)
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _read(
        self,
        wire: _Wire,
        source: asyncio.StreamReader,
        queue: asyncio.Queue[tuple[float, bytes] | None],
        way: Direction,
    ) -> None:
        loop = asyncio.get_running_loop()
        try:
            while data := await source.read(CHUNK):
                now = self.faults[way]
                is_unheard = wire.is_mute and way == "to station"
                if now.is_swallowed or is_unheard or wire.is_dead or wire.directions_ended:
                    continue
                if now.garbage and self._random.random() < now.garbage:
                    data = self._spoilt(data)
                await queue.put((loop.time() + now.delay_s + self._random.random() * now.jitter_s, data))
        except OSError:
            pass
        await queue.put(None)

    async def _write(
        self,
        wire: _Wire,
        sink: asyncio.StreamWriter,
        queue: asyncio.Queue[tuple[float, bytes] | None],
        way: Direction,
    ) -> None:
        loop = asyncio.get_running_loop()
        try:
            while (item := await queue.get()) is not None:
                due_s, data = item
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                await self._flows.wait()
                while data:
                    # Looked at again and again: it may be healed in the middle of a piece.
                    rate = self.faults[way].bytes_per_s
                    step = max(1, int(rate / 50)) if rate else len(data)
                    sink.write(data[:step])
                    await sink.drain()
                    data = data[step:]
                    if rate:
                        await asyncio.sleep(step / rate)
        except OSError:
            pass
        finally:
            while not queue.empty():  # the reader may wait for room
                queue.get_nowait()
            self._end(wire, sink)

    def _end(self, wire: _Wire, sink: asyncio.StreamWriter) -> None:
        """One direction is over. A dead wire tells nobody until both ends have gone by themselves."""
        wire.directions_ended += 1
        if not wire.is_dead and not wire.is_mute:
            sink.transport.abort()
        if wire.directions_ended == 2:
            for end in wire.ends:
                end.transport.abort()
                self._writers.discard(end)
            self._wires.discard(wire)

    def _spoilt(self, data: bytes) -> bytes:
        spoilt = bytearray(data)
        spoilt[self._random.randrange(len(spoilt))] ^= self._random.randrange(1, 256)
        return bytes(spoilt)
