"""robot-server's core: listens for stations, moves sensor data to them and their commands to the devices."""

from __future__ import annotations

import asyncio
import itertools
import logging
import secrets
import socket
import time
from collections.abc import Callable
from typing import cast

import msgspec

from robot.access import UNKNOWN_STATION, Gate, check_roles, may
from robot.commands import About, CommandDesk, notice
from robot.config import RobotConfig
from robot.datagram_port import DatagramPort
from robot.depth import DepthSlot, DepthStream
from robot.devices.ports import DeviceSet
from robot.doorstep import Doorstep
from robot.head import STEP_S, CameraHead
from robot.health import CpuMeter, read_battery, read_temperatures
from robot.measured_motors import MeasuredMotors
from robot.outbox import ImuBacklog, ImuCursor
from robot.own_calibration import OwnCalibration
from robot.recalibration import Recalibration
from robot.recompress import Recompressor
from robot.sensors import Faults, pump_camera, pump_depth, pump_imu
from robot.station_client import StationClient
from robot.systemd import Systemd
from robot.video import FrameSlot, VideoStream
from robot.watchdog import STANDSTILL, MotorWatchdog, Velocity
from shared.access import Role
from shared.errors import HardwareError
from shared.messages import (
    PROTOCOL_VERSION,
    AskDatagrams,
    DatagramReport,
    DriveApplied,
    ErrorCode,
    ErrorNotice,
    Heartbeat,
    Hello,
    Hijack,
    Join,
    PairProof,
    PairRequest,
    Prove,
    Received,
    Refusal,
    StationDatagram,
    StationMessage,
    Status,
    UndoCalibration,
    UseCalibration,
    Welcome,
)
from shared.prompt_sending import UNSENT_BYTES, send_promptly
from shared.reception import Caller, Reception
from shared.seats import Rank, Seats, rank_of
from shared.session import Event, State, reply_to

logger = logging.getLogger(__name__)

TICK_S = 0.05  # also the interval of drive reports: 20 Hz
TICKS_PER_STATUS = 20
STRANGER_WITHIN_S = 10.0  # handshake, greeting and pairing; whoever is silent meanwhile is ended earlier
SEATS_PER_TOKEN = 2  # a station, and the connection it has lost without a word
TICKS_PER_LOOK = 10  # at the book of tokens: who was revoked is out within half a second


class RobotServer:
    """Serves one robot's devices to stations until cancelled. Motors stop first, whatever ends it."""

    def __init__(
        self,
        devices: DeviceSet,
        config: RobotConfig,
        *,
        starts_with_first_station: bool = False,
        gate: Gate | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        systemd: Systemd | None = None,
        calibration: OwnCalibration | None = None,
    ) -> None:
        """`gate`: who may connect; None: everybody who reaches the port. `calibration`: None: kept only in memory."""
        check_roles()
        self._doorstep = Doorstep(gate)
        self._ends = False
        self._devices = devices
        self._systemd = systemd or Systemd()
        self._config = config
        self._now_ns = now_ns
        self._loop: asyncio.AbstractEventLoop | None = None
        self.watchdog = None
        if devices.motors is not None:
            motors = MeasuredMotors(devices.motors, lambda: self.recalibration.own.current.wheel_factors)
            self.watchdog = MotorWatchdog(motors, self._report_from_thread)
        self.desk = CommandDesk(devices, self.watchdog, config.drive)
        self.faults = Faults(self._broadcast_fault)
        self._recompressor = Recompressor(self._wake_all, now_ns)
        self._frames = FrameSlot(self._recompressor.begin)
        self._depth = DepthSlot()
        self._backlog = ImuBacklog(config.server.imu_backlog_samples)
        self._clients: dict[int, StationClient] = {}
        self._datagrams = DatagramPort(now_ns, self._handle_datagram)
        self._seats = Seats(config.server.max_stations, SEATS_PER_TOKEN)
        self._next_client_id = 1
        self._started_ns = now_ns()
        self._session_id = secrets.token_hex(8)
        self._may_start = asyncio.Event()
        if not starts_with_first_station:
            self._may_start.set()
        self._cpu = CpuMeter()
        self.recalibration = Recalibration(
            calibration or OwnCalibration(None, devices.calibration), self._clients, self._is_driven
        )

    async def serve(self, listener: socket.socket) -> None:
        """Serve stations on a bound socket until cancelled."""
        self._loop = asyncio.get_running_loop()
        try:
            async with asyncio.TaskGroup() as tasks:
                self.recalibration.tasks = tasks
                tls = self._doorstep.tls()
                reception = Reception(
                    listener,
                    tls,
                    self._config.server.max_waiting,
                    STRANGER_WITHIN_S,
                    lambda caller: _Streams(caller, lambda *streams: self._take_in(tasks, caller, *streams)),
                    callers_speak_first=bool(tls),  # without it the robot does
                )
                self._datagrams.open(listener)
                receiving = tasks.create_task(reception.run())
                try:
                    tasks.create_task(self._tick_forever())
                    tasks.create_task(self._lead_head_forever())
                    tasks.create_task(self._run_sensors())
                    self._systemd.ready()
                    await asyncio.Event().wait()
                finally:
                    self.stop_motors()
                    self._systemd.ending()
                    self._ends = True
                    receiving.cancel()
                    await self._say_goodbye()
        finally:
            self.stop_motors()
            self._datagrams.close()
            self._loop = self.recalibration.tasks = None
            self._recompressor.close()
            await self._devices.close()

    def stop_motors(self) -> None:
        """Motors off for good: the first thing every way out does."""
        if self.watchdog is not None:
            self.watchdog.close()

    def hello(self, challenge: bytes = b"") -> Hello:
        """What every station is told first."""
        identity = self._config.identity
        robot_id = identity.id or socket.gethostname() or "robot"
        return Hello(
            protocol=PROTOCOL_VERSION,
            robot_id=robot_id,
            name=identity.name or robot_id,
            session_id=self._session_id,
            capabilities=self.desk.capabilities(),
            calibration=self.recalibration.own.current,
            challenge=challenge,
            calibration_origin=self.recalibration.own.origin,
            datagram_port=self._datagrams.number,
        )

    # Connections

    def _take_in(
        self, tasks: asyncio.TaskGroup, caller: Caller, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        if self._ends:  # its handshake took longer than we live
            writer.transport.abort()
            return
        send_promptly(writer.get_extra_info("socket"), UNSENT_BYTES)
        client = StationClient(self._next_client_id, caller, reader, writer, self._now_ns, self._devices.clock)
        self._next_client_id += 1
        self._doorstep.receive(client)
        self._clients[client.id] = client
        tasks.create_task(self._serve_client(client))

    async def _serve_client(self, client: StationClient) -> None:
        try:
            await client.run(self.hello(client.challenge), self._handle, lambda leaving: self.desk.leave(leaving.id))
        except Exception:
            logger.exception("connection %d failed", client.id)
        finally:
            del self._clients[client.id]
            self._datagrams.forget(client)
            name = client.station_name or f"connection {client.id}"
            logger.info("%s left: %s", name, client.session.close_reason)

    def _handle(self, client: StationClient, message: Join | StationMessage) -> None:
        if not may(client.role, message):
            self._refuse(client, message)
            return
        if isinstance(message, Prove | PairRequest | PairProof):
            self._doorstep.introduce(client, message)
            return
        if isinstance(message, Join):
            self._welcome(client, message)
            return
        if isinstance(message, Received):
            client.confirm(message)
            if client.meter.has_heard_ns is not None:
                self.desk.note_heard(client.id, client.meter.has_heard_ns)
            return
        if isinstance(message, AskDatagrams):
            self._datagrams.answer(client, message)
            return
        if isinstance(message, UseCalibration | UndoCalibration):
            self.recalibration.order(client, message)
            return
        if isinstance(message, Heartbeat):
            # Whoever may not drive may keep nobody else from driving.
            self.desk.keep_standing(client.id, message.must_stand is True and _may_drive(client))
            t_robot_ns = self._devices.clock()
            took_stop = self.watchdog is None or not self.watchdog.stop_fault
            reply = reply_to(message, t_robot_ns, t_robot_ns, took_stop=took_stop)
            client.put(reply)
            if client.datagrams is not None:
                client.datagrams.note_beat(reply, client.read_ns)
        if (refusal := self.desk.handle(client.id, message, client.read_ns)) is not None:
            client.put(refusal)

    def _handle_datagram(self, client: StationClient, message: StationDatagram, read_ns: int) -> None:
        """A copy of what goes by the connection too, of a session that has joined and has not ended.

        What its role does not allow is refused where the other copy comes. Nothing here answers for the order in which
        the connection is read, so a heartbeat's reply still confirms a stop.
        """
        if not client.is_joined:
            return
        if isinstance(message, DatagramReport):
            self.desk.note_time(client.id, message.t_station_ns, read_ns)
        elif may(client.role, message):
            refusal = self.desk.handle(client.id, message, read_ns, is_datagram=True)
            if refusal is not None:
                client.put(refusal)

    def _refuse(self, client: StationClient, message: StationMessage) -> None:
        if client.role is None:
            client.end(Event.REFUSAL, Refusal(reason=UNKNOWN_STATION))
            return
        self.desk.refused += 1
        about = _about(message)
        text = f"{message} is refused: this station may only {client.role.value}"
        client.put(notice("not_allowed", text, about=about))

    def _welcome(self, client: StationClient, join: Join) -> None:
        if self.recalibration.is_running and not join.knows_calibration_changed:
            client.end(Event.REFUSAL, Refusal(reason="the robot's calibration is just being written; connect again"))
            return
        rank = _rank(client)
        if self._seats.is_full and (silent := self._silent_station(rank)) is not None:
            self._end(silent, "silent", "this station was silent, and another needs its place")
        if not client.caller.know(self._seats, client.token_id, rank, lambda: self._replace(client)):
            limit = self._config.server.max_stations
            client.end(Event.REFUSAL, Refusal(reason=f"{limit} stations are connected, no more are allowed"))
            return
        client.station_name = join.station_name
        # What a station says of itself counts beside its token: nobody drives as another one.
        if join.station_id:
            self.desk.join(client.id, f"{client.token_id} {join.station_id}")
        client.knows_calibration_changed = join.knows_calibration_changed
        client.put(Welcome(client_id=client.id))
        client.put(self._drive_report(self._applied()))
        client.put(self._status_for(client))
        client.video = VideoStream(self._frames, client.meter, is_on_this_machine=client.is_on_this_machine)
        if self._devices.depth is not None and join.knows_depth:
            client.depth = DepthStream(self._depth, client.meter, is_on_this_machine=client.is_on_this_machine)
        client.imu = self._imu_cursor(join)
        self._may_start.set()
        logger.info("%s joined as connection %d", join.station_name, client.id)

    def _silent_station(self, rank: Rank) -> StationClient | None:
        """Most likely the dead connection of a station that is back by another one.

        Not of one that may drive, for one that only watches: it may be in the middle of a roam.
        """
        silent = [c for c in self._clients.values() if c.session.state is State.QUIET and _rank(c) <= rank]
        return min(silent, key=_rank, default=None)

    def _replace(self, client: StationClient) -> None:
        self._end(
            client, "not_allowed", "another station needs this one's place: one with the same token or that may drive"
        )

    def _end(self, client: StationClient, code: ErrorCode, why: str) -> None:
        """Its seat is free at once, although its last word may take a second."""
        client.caller.left()
        client.end(Event.LOST, notice(code, why, fatal=True))

    def _imu_cursor(self, join: Join) -> ImuCursor:
        if join.resume_session_id == self._session_id and join.next_imu_sequence >= 0:
            return ImuCursor.resuming(self._backlog, join.next_imu_sequence)
        return ImuCursor(self._backlog, self._backlog.end)

    async def _say_goodbye(self) -> None:
        for client in list(self._clients.values()):
            client.end(Event.LOST, notice("shutdown", "robot-server is shutting down", fatal=True))
        # The connections' own tasks send it; they are ended with the task group after this.
        deadline_ns = self._now_ns() + 500_000_000
        while self._clients and self._now_ns() < deadline_ns:
            await asyncio.sleep(0.01)

    # Sensors

    async def _run_sensors(self) -> None:
        await self._may_start.wait()
        async with asyncio.TaskGroup() as tasks:
            if self._devices.camera is not None:
                tasks.create_task(
                    pump_camera(self._devices.camera, self._frames, self.faults, self._wake_all, self._now_ns)
                )
            if self._devices.imu is not None:
                interval_s = self._config.server.imu_batch_interval_ms * 1e-3
                tasks.create_task(pump_imu(self._devices.imu, self._backlog, self.faults, self._wake_all, interval_s))
            if self._devices.depth is not None:
                tasks.create_task(pump_depth(self._devices.depth, self._depth, self.faults, self._wake_all))
        if self._devices.camera is not None or self._devices.imu is not None:
            await self._wait_until_sent()
            self.faults.set("recording", "the recording has ended; restart robot-server to play it again")

    async def _wait_until_sent(self) -> None:
        """Notices overtake data; the one that says that all has been played should not."""
        deadline_ns = self._now_ns() + 2_000_000_000
        while self._now_ns() < deadline_ns and not all(c.has_all for c in self._clients.values()):
            await asyncio.sleep(0.01)

    def _wake_all(self) -> None:
        for client in self._clients.values():
            client.wake()

    def _broadcast_fault(self, device: str, sentence: str) -> None:
        self._broadcast(notice("end_of_recording" if device == "recording" else "device", sentence))

    # Reports

    async def _tick_forever(self) -> None:
        for count in itertools.count():
            await asyncio.sleep(TICK_S)
            self.desk.listen(self._now_ns())
            self._check_motors()
            # This loop turns and the motors' guard looks: only then is this robot-server worth keeping.
            if self.watchdog is None or self.watchdog.is_working:
                self._systemd.alive(self._now_ns())
            if count % TICKS_PER_STATUS == 0:
                self.faults.keep("robot", self._devices.problems())
            if count % TICKS_PER_LOOK == 0:
                self._doorstep.look(list(self._clients.values()))
            for client in list(self._clients.values()):
                if client.tick():
                    self.desk.go_quiet(client.id)
                if client.is_joined:
                    if self.watchdog is not None or self.desk.head is not None:
                        client.put(self._drive_report(self._applied()))
                    if count % TICKS_PER_STATUS == 0:
                        client.put(self._status_for(client))

    async def _lead_head_forever(self) -> None:
        head = self.desk.head
        if head is None:
            return
        while True:
            await asyncio.sleep(STEP_S)
            if head.lags(self._now_ns()):
                self._lead(head)

    def _lead(self, head: CameraHead) -> None:
        try:
            head.lead(self._now_ns())
        except HardwareError as exc:
            self.faults.set("head", f"the pan-tilt head does not obey: {exc}")
        else:
            self.faults.clear("head")

    def _check_motors(self) -> None:
        if self.watchdog is None:
            return
        self.watchdog.check()
        if self.watchdog.fault:
            self.faults.set("motors", self.watchdog.fault)
        else:
            self.faults.clear("motors")

    def _is_driven(self) -> bool:
        return self.desk.lease.driver(self._now_ns()) is not None or not self._applied().is_zero

    def _applied(self) -> Velocity:
        return STANDSTILL if self.watchdog is None else self.watchdog.applied

    def _drive_report(self, velocity: Velocity) -> DriveApplied:
        head = self.desk.head
        pan, tilt = (0.0, 0.0) if head is None else head.told(self._now_ns())
        return DriveApplied(
            t_robot_ns=self._devices.clock(),
            linear=velocity.linear_m_s,
            angular=velocity.angular_rad_s,
            pan=pan,
            tilt=tilt,
        )

    def _report_from_thread(self, velocity: Velocity) -> None:
        """Called by the watchdog's thread on each change: its time is taken there, the sending is the loop's."""
        report, loop = self._drive_report(velocity), self._loop
        if loop is None:
            return
        try:
            loop.call_soon_threadsafe(self._broadcast, report)
        except RuntimeError:
            logger.debug("drive report after the event loop's end")

    def _broadcast(self, message: DriveApplied | ErrorNotice) -> None:
        for client in self._clients.values():
            if client.is_joined:
                client.put(message)

    def _status_for(self, client: StationClient) -> Status:
        now_ns = self._now_ns()
        voltage_v, fraction = read_battery(self._devices.battery, self.faults)
        driver = next((c for c in self._clients.values() if self.desk.is_driven_by(c.id, now_ns)), None)
        return Status(
            t_robot_ns=self._devices.clock(),
            uptime_s=(now_ns - self._started_ns) * 1e-9,
            battery_v=voltage_v,
            battery_fraction=fraction,
            temperatures_c=read_temperatures(),
            cpu_percent=self._cpu.percent(),
            frames_captured=self._frames.count,
            frames_skipped=client.video.skipped if client.video else 0,
            imu_samples=self._backlog.end,
            imu_lost_in_sensor=self._backlog.lost_in_sensor,
            imu_lost_in_backlog=client.imu.lost if client.imu else 0,
            messages_dropped=client.messages_dropped,
            stations=sum(c.is_joined for c in self._clients.values()),
            driver=driver.station_name if driver is not None else None,
            you_drive=self.desk.is_driven_by(client.id, now_ns),
            watchdog_stops=0 if self.watchdog is None else self.watchdog.stops,
            commands_refused=self.desk.refused,
            faults=self.faults.sentences(),
        )


def _rank(client: StationClient) -> Rank:
    return rank_of(client.role or Role.WATCH)


def _may_drive(client: StationClient) -> bool:
    return client.role is not None and client.role.includes(Role.DRIVE)


def _about(message: StationMessage) -> About:
    """What the refusal of a message answers, where an answer is waited for."""
    match message:
        case Hijack():
            return "hijack"
        case UseCalibration() | UndoCalibration():
            return "calibration"
        case _:
            return msgspec.UNSET


class _Streams(asyncio.StreamReaderProtocol):
    """What a new connection speaks; `take_in` gets it when its handshake is done."""

    def __init__(self, caller: Caller, take_in: Callable[[asyncio.StreamReader, asyncio.StreamWriter], None]) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(asyncio.StreamReader(loop=loop), take_in, loop=loop)
        self._caller = caller

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._caller.made(cast(asyncio.Transport, transport))
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._caller.left()
        super().connection_lost(exc)
