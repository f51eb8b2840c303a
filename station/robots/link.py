"""The station's connection to one robot: stays connected, hands on what arrives and sends what is asked."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import msgspec

from shared.access import prove
from shared.errors import ConfigError, RemoteProtocolError
from shared.listening import show_address
from shared.messages import (
    PROTOCOL_VERSION,
    CalibrationChanged,
    CameraFrame,
    Datagrams,
    Depth,
    Drive,
    DriveApplied,
    ErrorNotice,
    HeartbeatReply,
    Hello,
    ImuBatch,
    Join,
    Message,
    Prove,
    Refusal,
    Status,
    Stop,
    Welcome,
)
from shared.session import MESSAGES_AT_A_TIME, Event, Session, State, Tick
from station.access.connecting import (
    CONNECT_WITHIN_S,
    READ_BYTES,
    Connection,
    ConnectionRefused,
    connect,
    connect_and_hear,
    in_words,
    until_forgotten,
)
from station.access.paired_robots import PairedRobots
from station.robots.datagrams import PictureDatagrams
from station.robots.link_clock import LinkClock
from station.robots.link_commands import DueMessages, LinkCommands
from station.robots.link_events import LinkListener
from station.robots.link_log import LinkLog
from station.robots.link_state import MAY_BE_UNPAIRED, Arrivals, Hearing, LinkState, RateMeter, RobotIdentity
from station.robots.network import NetworkState, OwnPauses, RecentDelays
from station.robots.search import NO_ROBOT_FOUND, Find, RobotSearch, find_in_network

logger = logging.getLogger(__name__)

RETRY_S = 0.25  # a robot that just started is found well within two seconds
REFUSED_RETRY_S = 1.5  # somebody must do something first: pair, or set up; or a handshake was cut in the middle
GREETED_WITHIN_NS = 1_500_000_000  # a hello that was lost on the way must not cost more than a new connection
TICK_S = 0.025
AUTO = "auto"  # as host: look for a robot


class RobotLink:
    """Connection to the robot-server at host:port. All methods belong on the event loop that runs `run()`.

    Host "auto" looks for a robot in the local network first, whenever there is no connection.
    """

    def __init__(
        self,
        host: str,
        port: int,
        listener: LinkListener,
        *,
        station_name: str = "station",
        now_ns: Callable[[], int] = time.monotonic_ns,
        find: Find | None = None,
        robots: PairedRobots | None = None,
    ) -> None:
        """`robots`: who is paired with this station; None: robots are met without TLS wherever they are."""
        self._search = RobotSearch(robots, find or find_in_network) if host == AUTO else None
        self._host = host
        self._port = port
        self._listener = listener
        self._station_name = station_name
        self._station_id = secrets.token_hex(8)
        self._now_ns = now_ns
        self._robots = robots
        self._connection: Connection | None = None
        self._other_way: Connection | None = None  # opened when the present one carried nothing, to go on with
        self._datagrams: PictureDatagrams | None = None
        self._retry_s = RETRY_S
        self._is_refused = False  # somebody must do something first
        self._session = Session("station", now_ns())
        self._due = DueMessages()
        self._silence = asyncio.Event()
        self.commands = LinkCommands(self._due, now_ns, late_ms=lambda: self._delays.late_ms)
        self.commands.on_command = self._send_beside
        self.on_refused: Callable[[str], None] = lambda _: None  # gets why somebody must do something, as it changes
        self._connected = False
        self._reason = "not connected yet"
        self._hello: Hello | None = None
        self._robot: RobotIdentity | None = None  # whose hello that is
        self._clock = LinkClock()
        self._rates = RateMeter()
        self._delays = RecentDelays()
        self._pauses = OwnPauses()
        self._arrived = Arrivals()
        self._hearing = Hearing()
        self._connections = 0
        self._status: Status | None = None
        self._notice: ErrorNotice | None = None
        self._log = LinkLog()

    @property
    def state(self) -> LinkState:
        frame_rate_hz, imu_rate_hz, bytes_per_s = self._rates.rates()
        return LinkState(
            host=self._host,
            port=self._port,
            connected=self._connected,
            quiet=self._connected and self._session.state is State.QUIET,
            hello=self._hello,
            robot=self._robot,
            reason="" if self._connected else self._reason,
            connections=self._connections,
            network=self._network(frame_rate_hz),
            rtt_ms=None if self._clock.rtt_ns is None else self._clock.rtt_ns * 1e-6,
            clock_offset_ns=self._clock.offset_ns(self._now_ns()),
            clock_bound_ns=self._clock.bound_ns(self._now_ns()),
            clock_drift_ppm=self._clock.drift_ppm,
            frame_rate_hz=frame_rate_hz,
            imu_rate_hz=imu_rate_hz,
            received_bytes_per_s=bytes_per_s,
            frames=self._arrived.frames,
            frames_skipped=self._arrived.frames_skipped,
            imu_samples=self._arrived.imu_samples,
            imu_gaps=self._arrived.imu_gaps,
            imu_lost=self._arrived.imu_lost,
            status=self._status,
            notice=self._notice,
        )

    def _network(self, frame_rate_hz: float) -> NetworkState:
        if not self._connected:
            return NetworkState("none", self._reason)
        is_quiet = self._session.state is State.QUIET
        is_same_machine = self._connection is not None and self._connection.is_loopback
        state = self._delays.state(frame_rate_hz, is_quiet, is_same_machine)
        is_slow = state.grade in ("slow", "bad") and not state.computer_busy
        if is_slow and self._datagrams is not None and self._datagrams.is_blocked:
            return replace(state, sentence=f"{state.sentence}; {self._datagrams.why_blocked}")
        return state

    def to_station_ns(self, t_robot_ns: int) -> int | None:
        """The station's monotonic time of a robot time; None before the clocks are known."""
        return self._clock.to_station_ns(t_robot_ns)

    async def run(self) -> None:
        """Connect, and connect again whenever the connection is lost, until cancelled."""
        try:
            while True:
                await self._run_once()
                await asyncio.sleep(self._retry_s)
        finally:
            if self._other_way is not None:
                self._other_way.writer.transport.abort()

    async def _run_once(self) -> None:
        was_connected = self._is_refused = False
        self._retry_s = RETRY_S
        search = self._search if self._other_way is None else None
        try:
            self._reason = await (self._connect_once() if search is None else self._find_and_connect(search))
        finally:
            was_connected, self._connected = self._connected, False
            self.commands.close()
            self._rates = RateMeter()  # nothing arrives now
        if was_connected:
            self._log.lost(self._reason)
            self._listener.on_disconnected(self._reason)
        elif self._is_refused and self._log.refused(self._reason):
            self.on_refused(self._reason)

    async def _find_and_connect(self, search: RobotSearch) -> str:
        """Try who makes itself known; returns the sentence why there is no connection any longer."""
        found = await search.next()
        if found is None:
            return NO_ROBOT_FOUND
        self._host, self._port = found.host, found.port
        reason = await self._connect_once()
        if self._connected:
            return reason
        if search.has_more:
            self._retry_s = 0.0
        return search.refuse(found, reason)

    async def _connect_once(self) -> str:
        """Connect and stay connected; returns the sentence why not any longer."""
        address = show_address(self._host, self._port)
        try:
            connection = await self._open()
        except TimeoutError:
            self._retry_s = 0.0  # it has waited long enough; what was lost on the way does not come any more
            return f"no answer from {address}; check that the robot is on and in this network"
        except OSError as exc:
            return f"{in_words(exc, address)}; start robot-server there"
        except (ConnectionRefused, ConfigError) as exc:
            self._retry_s, self._is_refused = REFUSED_RETRY_S, True
            return str(exc)
        except UnicodeError as exc:  # no name that DNS could hold, such as a..b
            logger.info("%s: %s", self._host, exc)
            return f"{self._host} is no host name; give --robot HOST:PORT"
        writer = connection.writer
        self._connection = connection
        self._session = Session("station", self._now_ns(), join_within_ns=GREETED_WITHIN_NS)
        self._due.clear()
        self._arrived.begin_connection()
        self._delays, self._pauses = RecentDelays(), OwnPauses()
        self._silence.clear()
        self.commands.restart_count()
        # No task group: of an end and a cancellation in the same moment it reports the end only (until Python 3.13).
        parts = [self._read(connection), self._write(writer), self._tick(), self._look_for_another_way()]
        if self._robots is not None and connection.fingerprint:
            parts.append(self._end_when_forgotten(connection.fingerprint, self._robots))
        tasks = [asyncio.create_task(part) for part in parts]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            writer.transport.abort()
            if self._datagrams is not None:
                self._datagrams.close()
                self._datagrams = None
            ends = await asyncio.gather(*tasks, return_exceptions=True)
        for end in ends:
            if isinstance(end, OSError):
                self._session.close(Event.LOST, f"connection lost: {in_words(end, address)}")
            elif isinstance(end, Exception) and not isinstance(end, _Ended):
                raise end
        is_mute = self._robots is not None and not connection.fingerprint and self._arrived.is_empty
        return self._session.close_reason + (MAY_BE_UNPAIRED if is_mute else "")

    async def _open(self) -> Connection:
        """The way that was opened already, or a new one."""
        other_way, self._other_way = self._other_way, None
        if other_way is not None:
            return other_way
        async with asyncio.timeout(CONNECT_WITHIN_S):
            return await connect(self._host, self._port, self._robots, is_given=self._search is None)

    async def _read(self, connection: Connection) -> None:
        session, heard = self._session, connection.heard
        num_messages = 0
        while data := heard or await connection.reader.read(READ_BYTES):
            heard = b""
            self._arrived.add_bytes(len(data), self._now_ns())
            session.receive(data)
            try:
                while (message := session.next_message(self._now_ns())) is not None:
                    self._receive(message, self._now_ns())
                    if session.state is State.CLOSED:
                        raise _Ended
                    num_messages += 1
                    if num_messages % MESSAGES_AT_A_TIME == 0:
                        await asyncio.sleep(0)
            except RemoteProtocolError as exc:
                raise _Ended from exc  # the session holds the reason
        session.close(Event.LOST, "the robot closed the connection")
        raise _Ended

    async def _write(self, writer: asyncio.StreamWriter) -> None:
        with _closed_is_lost():
            writer.transport.set_write_buffer_limits(high=1, low=0)  # 0 would pause a TLS transport for ever
        while True:
            await self._due.wait()
            while (message := self._due.pop()) is not None:
                if self._session.state is State.CLOSED:
                    raise _Ended  # the reader saw the end while we waited: what was due is said to nobody
                data = self._session.send(message)
                with _closed_is_lost():
                    writer.write(data)
                await writer.drain()

    async def _tick(self) -> None:
        session = self._session
        while True:
            now_ns = self._now_ns()
            self._pauses.note(now_ns)
            for duty in session.tick(now_ns):
                if duty is Tick.SEND_HEARTBEAT:
                    self.commands.beat()
                    self._confirm()
                    if self._datagrams is not None:
                        self._datagrams.report()
                elif duty is Tick.WENT_QUIET:
                    self._silence.set()
                elif duty is Tick.CLOSE:
                    self._retry_s = 0.0
                    raise _Ended
            if self._datagrams is not None:
                self._datagrams.repeat_command()
            if self._is_unheard(now_ns):
                self._silence.set()
            self._rates.sample(now_ns, self._arrived.frames, self._arrived.imu_samples, self._num_bytes)
            self._pauses.expect(self._now_ns() + round(TICK_S * 1e9))
            await asyncio.sleep(TICK_S)

    async def _look_for_another_way(self) -> None:
        """While nothing is heard: a connection may be dead and neither end know (a router that started anew forgot it).

        Whether it is shows when the robot answers a new one. Silence alone may be a roam, which the old one survives.
        """
        session = self._session
        while True:
            await self._silence.wait()
            self._silence.clear()
            while session.state is State.QUIET or self._is_unheard(self._now_ns()):
                num_bytes = self._arrived.bytes  # half a message that trickles is life enough
                way = await connect_and_hear(self._host, self._port, self._robots, is_given=self._search is None)
                is_silent = session.state is State.QUIET and self._arrived.bytes == num_bytes
                if way is not None and (is_silent or self._is_unheard(self._now_ns())):
                    self._retry_s, self._other_way = 0.0, way
                    what = "carries nothing any more" if is_silent else "does not reach the robot any more"
                    session.close(Event.LOST, f"the connection {what}, and the robot answers a new one")
                    raise _Ended
                if way is not None:
                    way.writer.transport.abort()
                await asyncio.sleep(RETRY_S)

    async def _end_when_forgotten(self, fingerprint: bytes, robots: PairedRobots) -> None:
        self._session.close(Event.LOST, await until_forgotten(fingerprint, robots))
        raise _Ended

    def _is_unheard(self, now_ns: int) -> bool:
        return self._connected and self._hearing.is_lost(now_ns)

    def _receive(self, message: Message, now_ns: int) -> None:
        self._hearing.note_message(now_ns)
        match message:
            case CameraFrame():
                self._receive_frame(message, now_ns)
            case ImuBatch():
                self._receive_imu(message)
            case DriveApplied():
                self._clock.add_stamp(message.t_robot_ns, now_ns)
                self._listener.on_drive_applied(message)
            case Depth():
                self._listener.on_depth(message)
            case HeartbeatReply():
                self._hearing.note_answer(now_ns)
                self._clock.add_reply(message, now_ns)
                if (trip_ns := self._clock.rtt_ns) is not None:
                    self._delays.add_round_trip(trip_ns, self._pauses.within_ns(now_ns - trip_ns, now_ns))
                if message.took_stop:
                    self.commands.receive_beat(message.seq)
            case Status():
                self._status = message
                self._listener.on_status(message)
            case ErrorNotice():
                self._receive_notice(message)
            case CalibrationChanged():
                self._recalibrate(message)
            case Datagrams():
                if self._datagrams is not None:
                    self._datagrams.begin(message)
            case Hello():
                self._greet(message)
            case Welcome():
                self._connected = True
                if self._search is not None and self._robot is not None:
                    self._search.accept(self._robot)
                self.commands.open(None if self._hello is None else self._hello.capabilities)
                self._connections += 1
                self._hearing.note_answer(now_ns)
                self.commands.beat()  # at once: the robot needs something to tell late commands by
                if self._hello is not None:
                    self._ask_datagrams(self._hello)
                    self._listener.on_connected(self._hello)
            case Refusal():
                self._is_refused = True
                self._retry_s = REFUSED_RETRY_S if self._hello is not None and self._hello.challenge else RETRY_S
                self._session.close_reason = f"the robot refused this station: {message.reason}"
            case _:
                pass

    def _ask_datagrams(self, hello: Hello) -> None:
        """For pictures, where a network lies between that may lose packets."""
        if self._connection is None or not hello.datagram_port or self._connection.is_loopback:
            return
        host, _, *scope = self._connection.peer
        robot = (host, hello.datagram_port, *scope)
        try:
            self._datagrams = PictureDatagrams(robot, self._receive_frame, self._clock.add_exchange, self._now_ns)
        except OSError as exc:
            logger.warning("no UDP socket (%s): pictures come over TCP alone", exc)
            return
        self._due.put(self._datagrams.question())

    def _send_beside(self, command: Drive | Stop) -> None:
        if self._datagrams is not None and self._session.state is not State.CLOSED:
            self._datagrams.command(command)

    @property
    def _num_bytes(self) -> int:
        return self._arrived.bytes + (0 if self._datagrams is None else self._datagrams.num_bytes)

    def _receive_frame(self, frame: CameraFrame, now_ns: int) -> None:
        """By either way; what the other one has overtaken is left out."""
        if not self._arrived.add_frame(frame):
            return
        self._confirm()
        if (taken_ns := self._clock.to_station_ns(frame.t_robot_ns)) is not None:
            self._delays.add_picture(now_ns - taken_ns, self._pauses.within_ns(taken_ns, now_ns))
        self._listener.on_frame(frame, now_ns)

    def _confirm(self) -> None:
        self._due.put(self._arrived.confirmation(self._now_ns()))

    def _greet(self, hello: Hello) -> None:
        connection = self._connection
        robot = RobotIdentity(hello.robot_id, b"" if connection is None else connection.fingerprint)
        if self._search is not None and (refusal := self._search.refusal(robot)):
            self._retry_s, self._is_refused = REFUSED_RETRY_S, True
            self._session.close(Event.LOST, refusal)
            return
        is_same_run = self._hello is not None and self._hello.session_id == hello.session_id
        if not is_same_run:  # another count of samples, and perhaps another clock
            self._arrived.begin_run()
            self._clock = LinkClock()
        if self._robot not in (None, robot):
            self.commands.forget_stop()
        self._hello, self._robot = hello, robot
        if hello.challenge and connection is not None and connection.token is not None:
            proof = prove(connection.token, hello.challenge, connection.fingerprint)
            self._due.put(Prove(token_id=connection.token.id, proof=proof))
        self._due.put(
            Join(
                protocol=PROTOCOL_VERSION,
                station_name=self._station_name,
                resume_session_id=hello.session_id if is_same_run else "",
                next_imu_sequence=self._arrived.next_imu_sequence,
                knows_calibration_changed=True,
                knows_depth=True,
                station_id=self._station_id,
            )
        )

    def _recalibrate(self, changed: CalibrationChanged) -> None:
        if self._hello is not None:
            told = {"calibration": changed.calibration, "calibration_origin": changed.origin}
            self._hello = msgspec.structs.replace(self._hello, **told)
            self._listener.on_calibration(self._hello)
        self.commands.receive_calibration(changed)

    def _receive_imu(self, batch: ImuBatch) -> None:
        if missing := self._arrived.add_imu(batch):
            self._listener.on_gap(missing)
        self._listener.on_imu(batch)

    def _receive_notice(self, notice: ErrorNotice) -> None:
        self._notice = notice
        self._log.notice(notice.message)
        self.commands.receive_notice(notice)
        if notice.fatal:
            self._session.close_reason = f"the robot closed the connection: {notice.message}"
        self._listener.on_notice(notice)


@contextlib.contextmanager
def _closed_is_lost() -> Iterator[None]:
    """uvloop's transport raises RuntimeError where it was closed and its reader does not know yet."""
    try:
        yield
    except RuntimeError as exc:
        raise ConnectionResetError(str(exc)) from exc


class _Ended(Exception):
    """Ends the tasks of a connection; the session holds the reason."""
