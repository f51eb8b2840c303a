"""A robot-server and links in one event loop, over real sockets on free ports, with devices that tests push."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TypedDict, Unpack

from robot.commands import CommandDesk
from robot.config import RobotConfig, ServerConfig
from robot.devices.ports import BatteryState, CapturedFrame, DeviceSet, ImuReading
from robot.server import RobotServer
from shared.calibration import REFERENCE_ROBOT, Calibration
from shared.listening import bind
from shared.messages import (
    PROTOCOL_VERSION,
    CameraFrame,
    Capabilities,
    Depth,
    DriveApplied,
    ErrorNotice,
    Hello,
    ImuBatch,
    StationMessage,
    Status,
    Stop,
)
from station.robots.link import RobotLink

WAIT_S = 90.0  # for a condition; only a failing test, or one on a crowded machine, waits so long


async def until(condition: Callable[[], object]) -> None:
    """Wait for a condition."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "the awaited condition did not come true"
        await asyncio.sleep(0.005)


class FakeCamera:
    """Gives the frames that a test puts in."""

    def __init__(self) -> None:
        self.frames: asyncio.Queue[CapturedFrame | Exception] = asyncio.Queue()
        self.is_closed = False

    def put(self, t_robot_ns: int, size: int = 1000) -> None:
        self.frames.put_nowait(CapturedFrame(t_robot_ns, 5_000_000, 640, 480, bytes(size)))

    async def capture(self) -> CapturedFrame:
        frame = await self.frames.get()
        if isinstance(frame, Exception):
            raise frame
        return frame

    async def close(self) -> None:
        self.is_closed = True


class FakeImu:
    """Gives the samples that a test injects."""

    def __init__(self) -> None:
        self.next_sequence = 0
        self._readings: list[ImuReading] = []
        self._fresh = asyncio.Event()
        self.is_closed = False

    def inject(self, count: int) -> None:
        for _ in range(count):
            n = self.next_sequence
            self._readings.append(ImuReading(n, n * 4_444_444, (0.1, 0.2, float(n)), (0.0, 0.0, 9.81)))
            self.next_sequence += 1
        self._fresh.set()

    def inject_until(self, t_robot_ns: int) -> None:
        """One sample of now, for tests whose robot clock is this machine's."""
        self._readings.append(ImuReading(self.next_sequence, t_robot_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
        self.next_sequence += 1
        self._fresh.set()

    async def read(self) -> list[ImuReading]:
        await self._fresh.wait()
        self._fresh.clear()
        readings, self._readings = self._readings, []
        return readings

    async def close(self) -> None:
        self.is_closed = True


class FakeMotors:
    """Keeps what they were told, with the time."""

    def __init__(self) -> None:
        self.history: list[tuple[int, float, float]] = []
        self.stop_fault = ""  # why a stop does not reach them

    @property
    def are_off(self) -> bool:
        return self.history[-1][1:] == (0.0, 0.0)

    def drive(self, linear_m_s: float, angular_rad_s: float, until_ns: int) -> None:
        if time.monotonic_ns() < until_ns:
            self.history.append((time.monotonic_ns(), linear_m_s, angular_rad_s))

    def stop(self) -> str:
        self.history.append((time.monotonic_ns(), 0.0, 0.0))
        return self.stop_fault

    def close(self) -> None:
        self.stop()


@dataclass
class FakeHead:
    """Pan-tilt head, and the hand that picks a robot up."""

    pointed: list[tuple[float, float]] = field(default_factory=list)
    moved: list[tuple[float, float, float]] = field(default_factory=list)

    def point(self, pan_rad: float, tilt_rad: float) -> None:
        self.pointed.append((pan_rad, tilt_rad))

    def hijack(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        if abs(x_m) > 50:
            raise ValueError(f"({x_m:.2f}, {y_m:.2f}) m is not free floor of this world")
        self.moved.append((x_m, y_m, yaw_rad))

    def hijack_anywhere(self) -> None:
        self.moved.append((3.0, 4.0, 0.0))

    def close(self) -> None:
        pass


class FakeBattery:
    """Always half full."""

    def read(self) -> BatteryState:
        return BatteryState(7.4, 0.5)


@dataclass
class HearingDesk(CommandDesk):
    """The robot's own desk, that also keeps what it was told."""

    heard: list[StationMessage] = field(default_factory=list)

    def handle(
        self, client: int, message: StationMessage, now_ns: int, *, is_datagram: bool = False
    ) -> ErrorNotice | None:
        self.heard.append(message)
        return super().handle(client, message, now_ns, is_datagram=is_datagram)


class ServerOptions(TypedDict, total=False):
    """What a test sets of a bench's ServerConfig."""

    max_stations: int
    max_waiting: int
    imu_backlog_samples: int


class Bench:
    """One robot-server with fake devices."""

    def __init__(
        self,
        clock_rate: float = 1.0,
        calibration: Calibration = REFERENCE_ROBOT,
        **server: Unpack[ServerOptions],
    ) -> None:
        self._clock_rate = clock_rate
        self.camera, self.imu, self.motors, self.head = FakeCamera(), FakeImu(), FakeMotors(), FakeHead()
        self.calibration = calibration
        self.config = RobotConfig(server=ServerConfig(port=0, **server))
        self.port = 0
        self._server: RobotServer | None = None
        self.task: asyncio.Task[None] | None = None
        self.heard: list[StationMessage] = []  # everything stations said, in order

    @property
    def server(self) -> RobotServer:
        assert self._server is not None, "the bench was not started"
        return self._server

    def devices(self) -> DeviceSet:
        return DeviceSet(
            calibration=self.calibration,
            camera=self.camera,
            imu=self.imu,
            motors=self.motors,
            pan_tilt=self.head,
            battery=FakeBattery(),
            hijack=self.head,
            clock=self.clock,
        )

    def clock(self) -> int:
        """The robot's time; it may run fast or slow."""
        return round(time.monotonic_ns() * self._clock_rate)

    @property
    def stops_heard(self) -> int:
        """How often a station said stop: motors also come to rest when nobody says anything."""
        return sum(isinstance(message, Stop) for message in self.heard)

    async def start(self) -> None:
        """Start, or start again on the same port."""
        listener = bind("127.0.0.1", self.port)
        self.port = listener.getsockname()[1]
        self._server = RobotServer(self.devices(), self.config)
        desk = self.server.desk
        self.server.desk = HearingDesk(desk.devices, desk.watchdog, desk.limits, heard=self.heard)
        self.task = asyncio.create_task(self.server.serve(listener))

    async def stop(self) -> None:
        if self.task is not None:
            self.task.cancel()
            await asyncio.gather(self.task, return_exceptions=True)
            self.task = None


@asynccontextmanager
async def running_robot(
    clock_rate: float = 1.0, calibration: Calibration = REFERENCE_ROBOT, **server: Unpack[ServerOptions]
) -> AsyncIterator[Bench]:
    bench = Bench(clock_rate, calibration, **server)
    await bench.start()
    try:
        yield bench
    finally:
        assert bench.task is None or not bench.task.done(), "robot-server ended by itself"
        await bench.stop()


class Notes:
    """A listener that keeps everything."""

    def __init__(self) -> None:
        self.hellos: list[Hello] = []
        self.calibrations: list[Hello] = []  # hellos with another calibration than at the connection
        self.reasons: list[str] = []
        self.frames: list[tuple[CameraFrame, int]] = []
        self.batches: list[ImuBatch] = []
        self.gaps: list[int] = []
        self.depth: list[Depth] = []
        self.applied: list[DriveApplied] = []
        self.statuses: list[Status] = []
        self.notices: list[ErrorNotice] = []

    @property
    def sequences(self) -> list[int]:
        return [n for b in self.batches for n in range(b.first_sequence, b.next_sequence)]

    def on_connected(self, hello: Hello) -> None:
        self.hellos.append(hello)

    def on_calibration(self, hello: Hello) -> None:
        self.calibrations.append(hello)

    def on_disconnected(self, reason: str) -> None:
        self.reasons.append(reason)

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        self.frames.append((frame, t_station_ns))

    def on_imu(self, batch: ImuBatch) -> None:
        self.batches.append(batch)

    def on_gap(self, num_samples: int) -> None:
        self.gaps.append(num_samples)

    def on_depth(self, depth: Depth) -> None:
        self.depth.append(depth)

    def on_drive_applied(self, applied: DriveApplied) -> None:
        self.applied.append(applied)

    def on_status(self, status: Status) -> None:
        self.statuses.append(status)

    def on_notice(self, notice: ErrorNotice) -> None:
        self.notices.append(notice)


@asynccontextmanager
async def linked(
    port: int, name: str = "desk", now_ns: Callable[[], int] = time.monotonic_ns
) -> AsyncIterator[tuple[RobotLink, Notes]]:
    notes = Notes()
    link = RobotLink("127.0.0.1", port, notes, station_name=name, now_ns=now_ns)
    task = asyncio.create_task(link.run())
    try:
        await until(lambda: link.state.connected)
        yield link, notes
    finally:
        assert not task.done(), "the link ended by itself"
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


class Proxy:
    """A wire between station and robot that tests cut, stall, mend and lead elsewhere."""

    def __init__(self, target_port: int) -> None:
        self.target_port = target_port
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._flows = asyncio.Event()
        self._flows.set()
        self.port = 0

    async def mend(self) -> None:
        self._server = await asyncio.start_server(self._take, "127.0.0.1", self.port, limit=65536)
        self.port = self._server.sockets[0].getsockname()[1]

    async def cut(self) -> None:
        """No connection survives, none is taken."""
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in self._writers:
            writer.transport.abort()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def stall(self) -> None:
        """Bytes stay where they are, connections live."""
        self._flows.clear()

    def flow(self) -> None:
        self._flows.set()

    async def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            robot_reader, robot_writer = await asyncio.open_connection("127.0.0.1", self.target_port)
        except OSError:
            writer.transport.abort()
            return
        self._writers.add(robot_writer)
        for source, sink in ((reader, robot_writer), (robot_reader, writer)):
            task = asyncio.create_task(self._pass_on(source, sink))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _pass_on(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        try:
            while data := await source.read(65536):
                await self._flows.wait()
                sink.write(data)
                await sink.drain()
        except OSError:
            pass
        finally:
            sink.transport.abort()


def hello(session: str = "one", robot: str = "robot") -> Hello:
    able = Capabilities(camera=True, imu=True, drive=True, pan_tilt=True, battery=False, hijack=False)
    return Hello(
        protocol=PROTOCOL_VERSION,
        robot_id=robot,
        name=robot,
        session_id=session,
        capabilities=able,
        calibration=REFERENCE_ROBOT,
    )
