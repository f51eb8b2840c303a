"""Stations and pages behind bad networks, many in one process: each is cut at random moments, and must be back soon."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import math
import random
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import websockets

from shared.access import Role
from shared.messages import CameraFrame, Depth, DriveApplied, ErrorNotice, Hello, ImuBatch, Status
from station.access.paired_robots import PairedRobots
from station.robots.link import RobotLink
from tests.support.access import GuardedBench, set_up
from tests.support.fault_proxy import Direction, FaultProxy
from tests.support.link import Bench

FEED_S = 0.05
IMU_PER_FEED, FRAME_EVERY, FRAME_BYTES = 11, 4, 8_000  # 220 Hz, 5 pictures a second
PAUSE_S = 0.05  # shorter ones are what an event loop does
GIVE_UP_S = 30.0  # a line that is not back by then is broken for good
BOTH: tuple[Direction, ...] = ("to robot", "to station")
STEADY = "/ws/events"  # the station says something there every second
# As in station/web/src/link/socket.ts:
PAGE_FIRST_WAIT_S, PAGE_LONGEST_WAIT_S, PAGE_SILENCE_S, PAGE_PATIENCE_S, PAGE_GRACE_S = 0.25, 1.0, 1.25, 1.5, 0.4


@dataclass(frozen=True, slots=True)
class Return:
    """One fault and how long the line needed after it was over."""

    line: str
    fault: str
    number: int
    outage_s: float
    back_s: float
    ended_connection: bool
    lag_s: float  # for so long the event loop stood still meanwhile: not the line's fault


class Line(Protocol):
    """Something that connects through a proxy, and connects again."""

    name: str
    proxy: FaultProxy

    @property
    def connections(self) -> int:
        """How many there were so far."""
        ...

    @property
    def finds_garbage(self) -> bool:
        """Whether a wrong byte is noticed. TCP's checksums keep them out; who makes them all the same is in between.

        In WebSockets nothing shows one: a wrong length makes a side wait for the rest, until a ping is not answered.
        """
        ...

    def mark(self) -> None:
        """The network is sound from now on."""
        ...

    @property
    def is_back(self) -> bool:
        """Since `mark` something came through in each direction."""
        ...


class LagMeter:
    """When the event loop stood still: for want of a processor, or for the bench's own load."""

    def __init__(self) -> None:
        self._pauses: collections.deque[tuple[float, float]] = collections.deque(maxlen=10_000)  # end, length

    async def run(self) -> None:
        while True:
            begin_s = time.monotonic()
            await asyncio.sleep(0.01)
            now_s = time.monotonic()
            if now_s - begin_s > PAUSE_S:
                self._pauses.append((now_s, now_s - begin_s))

    def since(self, begin_s: float) -> float:
        """All pauses since then, together."""
        return sum(min(length_s, end_s - begin_s) for end_s, length_s in self._pauses if end_s > begin_s)


# Faults. Each returns when the network is sound again.

Fault = Callable[[FaultProxy, random.Random, float], Awaitable[None]]


async def _cut(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:  # noqa: ARG001
    """The port is closed too."""
    await proxy.cut()
    await asyncio.sleep(outage_s)
    await proxy.mend()


async def _reset(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:  # noqa: ARG001
    await proxy.reset()


async def _stall(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:  # noqa: ARG001
    proxy.stall()
    await asyncio.sleep(outage_s)
    proxy.flow()


async def _swallow(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:
    """Half-open: in one direction, or in both, bytes are lost."""
    for direction in rng.choice((BOTH[:1], BOTH[1:], BOTH)):
        proxy.faults[direction].is_swallowed = True
    await asyncio.sleep(outage_s)
    proxy.abandon()  # no TCP goes on behind a gap
    proxy.heal()


async def _abandon(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:  # noqa: ARG001
    """Half-open for good: only a new connection works."""
    proxy.abandon()


async def _garbage(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:
    proxy.faults[rng.choice(BOTH)].garbage = rng.choice((0.05, 0.5))
    await asyncio.sleep(outage_s)
    proxy.heal()


async def _throttle(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:
    for faults in proxy.faults.values():
        faults.bytes_per_s = rng.choice((5_000, 50_000))
    await asyncio.sleep(outage_s)
    proxy.heal()


async def _late_and_reset(proxy: FaultProxy, rng: random.Random, outage_s: float) -> None:  # noqa: ARG001
    """Late pieces, and a connection that ends while they are on the way: what comes again comes in another order."""
    for faults in proxy.faults.values():
        faults.delay_s, faults.jitter_s = 0.1, 0.1
    await asyncio.sleep(outage_s)
    await proxy.reset()
    proxy.heal()


FAULTS: dict[str, tuple[Fault, int]] = {  # and how often each
    "cut": (_cut, 4),
    "reset": (_reset, 4),
    "stall": (_stall, 1),
    "half-open": (_swallow, 2),
    "dead": (_abandon, 1),
    "garbage": (_garbage, 2),
    "throttle": (_throttle, 1),
    "late": (_late_and_reset, 2),
}


async def disturb(line: Line, rng: random.Random, lag: LagMeter, report: Callable[[Return], None]) -> None:
    """One fault after the other, until cancelled. Raises AssertionError when the line does not come back."""
    names, weights = list(FAULTS), [weight for _, weight in FAULTS.values()]
    number = 0
    while True:
        number += 1
        await asyncio.sleep(rng.uniform(0.0, 0.3))
        (name,) = rng.choices(names, weights)
        outage_s = rng.uniform(0.0, 0.5) if rng.random() < 0.9 else rng.uniform(0.5, 3.0)
        before = line.connections
        await FAULTS[name][0](line.proxy, rng, outage_s)
        if name == "garbage" and not line.finds_garbage:
            await line.proxy.reset()
        line.mark()
        begin_s = time.monotonic()
        while not line.is_back:
            await asyncio.sleep(0.01)
            waited_s = time.monotonic() - begin_s
            assert waited_s < GIVE_UP_S, f"{line.name} is not back {waited_s:.0f} s after fault {number}, {name}"
        back_s = time.monotonic() - begin_s
        ended = line.connections > before
        report(Return(line.name, name, number, outage_s, back_s, ended, lag.since(begin_s)))


# Robot and station


class Counts:
    """A listener that keeps numbers, not messages."""

    def __init__(self) -> None:
        self.connections = 0
        self.newest_sample = -1
        self.missing = 0
        self.is_in_order = True

    def on_connected(self, hello: Hello) -> None:  # noqa: ARG002
        self.connections += 1

    def on_calibration(self, hello: Hello) -> None: ...

    def on_imu(self, batch: ImuBatch) -> None:
        self.is_in_order &= batch.first_sequence > self.newest_sample
        self.newest_sample = batch.next_sequence - 1

    def on_gap(self, num_samples: int) -> None:
        self.missing += num_samples

    def on_disconnected(self, reason: str) -> None: ...

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None: ...

    def on_depth(self, depth: Depth) -> None: ...

    def on_drive_applied(self, applied: DriveApplied) -> None: ...

    def on_status(self, status: Status) -> None: ...

    def on_notice(self, notice: ErrorNotice) -> None: ...


@dataclass
class LinkLine:
    """A robot that measures, a station that listens and drives."""

    name: str
    bench: Bench
    proxy: FaultProxy
    link: RobotLink
    counts: Counts
    finds_garbage: bool = True
    _sample_at_mark: int = 0
    _heard_at_mark: int = field(default=0, repr=False)

    @property
    def connections(self) -> int:
        return self.counts.connections

    @property
    def in_order(self) -> bool:
        """Whether every inertial sample came once at most."""
        return self.counts.is_in_order

    @property
    def num_robot_clients(self) -> int:
        """Connections that the robot still holds."""
        return 0 if self.bench.task is None else len(self.bench.server._clients)

    def mark(self) -> None:
        self.bench.heard.clear()
        self.bench.motors.history.clear()
        self._sample_at_mark = self.bench.imu.next_sequence

    @property
    def is_back(self) -> bool:
        is_heard = bool(self.bench.heard)  # heartbeats at least
        return self.link.state.connected and is_heard and self.counts.newest_sample >= self._sample_at_mark

    async def feed(self) -> None:
        number = 0
        while True:
            self.bench.imu.inject(IMU_PER_FEED)
            number += 1
            if number % FRAME_EVERY == 0:
                self.bench.camera.put(number, FRAME_BYTES)
            await asyncio.sleep(FEED_S)


@asynccontextmanager
async def link_line(name: str, folder: Path, seed: int, *, has_tls: bool) -> AsyncIterator[LinkLine]:
    """Robot, network, station."""
    bench = GuardedBench(set_up(folder / name)) if has_tls else Bench()
    await bench.start()
    proxy = FaultProxy(bench.port, seed)
    await proxy.mend()
    robots: PairedRobots | None = None
    if isinstance(bench, GuardedBench):
        robots = PairedRobots(folder / f"{name}-station")
        robot_port, bench.port = bench.port, proxy.port
        bench.admit("desk", Role.DRIVE, robots)
        bench.port = robot_port
    counts = Counts()
    link = RobotLink("127.0.0.1", proxy.port, counts, robots=robots)
    line = LinkLine(name, bench, proxy, link, counts)
    tasks = [asyncio.create_task(link.run()), asyncio.create_task(line.feed())]
    try:
        yield line
    finally:
        await _end(tasks)
        await proxy.close()
        await bench.stop()


# Pages


@dataclass
class PageLine:
    """A page's sockets, which come back as station/web/src/link/socket.ts makes them (a browser test looks at it).

    The one that is told things each second, the steady one, finds out for all of them that nothing comes any more.
    """

    name: str
    proxy: FaultProxy
    paths: tuple[str, ...] = (STEADY, "/ws/camera")
    connections: int = 0
    finds_garbage: bool = False
    _messages: dict[str, int] = field(default_factory=dict)
    _at_mark: dict[str, int] = field(default_factory=dict)
    _heard_s: dict[str, float] = field(default_factory=dict)
    _resumed_s: float = -math.inf  # when the steady socket came back after it had been lost
    _sockets: dict[str, websockets.ClientConnection] = field(default_factory=dict, repr=False)
    _renewed: set[str] = field(default_factory=set)

    def mark(self) -> None:
        self._at_mark = dict(self._messages)

    @property
    def is_back(self) -> bool:
        return all(self._messages.get(path, 0) > self._at_mark.get(path, 0) for path in self.paths)

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            for path in self.paths:
                tasks.create_task(self._stay(path))
            tasks.create_task(self._watch())

    async def _stay(self, path: str) -> None:
        wait_s = PAGE_FIRST_WAIT_S
        was_open = False
        while True:
            try:
                async with self._connected(path) as socket:
                    wait_s = PAGE_FIRST_WAIT_S
                    self.connections += 1
                    self._sockets[path], self._heard_s[path] = socket, time.monotonic()
                    if path == STEADY and was_open:
                        self._resumed_s = self._heard_s[path]
                    was_open = True
                    async for _ in socket:
                        self._messages[path] = self._messages.get(path, 0) + 1
                        self._heard_s[path] = time.monotonic()
                        if path.endswith("camera"):
                            await socket.send("next")
            except (OSError, websockets.WebSocketException):
                pass
            self._sockets.pop(path, None)
            if path in self._renewed:  # we left it, it did not end
                self._renewed.discard(path)
                continue
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, PAGE_LONGEST_WAIT_S)

    def _connected(self, path: str) -> websockets.connect:
        return websockets.connect(
            f"ws://127.0.0.1:{self.proxy.port}{path}",
            open_timeout=PAGE_PATIENCE_S,
            close_timeout=0.2,
            ping_interval=None,
            compression=None,
        )

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(0.25)
            now_s = time.monotonic()
            for path in list(self._sockets):
                if self._heard_s[path] < self._resumed_s < now_s - PAGE_GRACE_S:
                    self._renew(path)
            if STEADY in self._sockets and now_s - self._heard_s[STEADY] > PAGE_SILENCE_S:
                await self._try_another(now_s)

    async def _try_another(self, begin_s: float) -> None:
        try:
            async with asyncio.timeout(PAGE_PATIENCE_S), self._connected(STEADY) as probe:
                await probe.recv()
        except (OSError, websockets.WebSocketException):
            return
        if self._heard_s[STEADY] < begin_s:
            for path in list(self._sockets):
                self._renew(path)

    def _renew(self, path: str) -> None:
        self._renewed.add(path)
        self._sockets[path].transport.abort()


@asynccontextmanager
async def page_line(name: str, http_port: int, seed: int) -> AsyncIterator[PageLine]:
    proxy = FaultProxy(http_port, seed)
    await proxy.mend()
    line = PageLine(name, proxy)
    task = asyncio.create_task(line.run())
    try:
        yield line
    finally:
        await _end([task])
        await proxy.close()


async def _end(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        assert not task.done(), f"it ended by itself: {task}"
        task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await asyncio.gather(*tasks, return_exceptions=True)
