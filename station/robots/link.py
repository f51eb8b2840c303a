"""The station's connection to one robot: stays connected, hands on what arrives and sends what is asked."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Protocol

from shared.access import prove
from shared.errors import ConfigError, LocalProtocolError, RemoteProtocolError
from shared.messages import (
    MAX_DRIVE_TTL_MS,
    PROTOCOL_VERSION,
    CameraFrame,
    Drive,
    DriveApplied,
    ErrorNotice,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Hijack,
    ImuBatch,
    Join,
    Message,
    PanTilt,
    Prove,
    Received,
    Refusal,
    StationMessage,
    Status,
    Stop,
    Welcome,
)
from shared.session import Event, Session, State, Tick
from station.access.connecting import (
    CONNECT_WITHIN_S,
    READ_BYTES,
    Connection,
    ConnectionRefused,
    answers,
    connect,
    in_words,
)
from station.access.paired_robots import PairedRobots
from station.errors import NoRobot
from station.robots.link_state import LinkClock, LinkState, RateMeter

__all__ = ["LinkListener", "LinkState", "RobotLink"]

logger = logging.getLogger(__name__)

RETRY_S = 0.25  # a robot that just started is found well within two seconds
REFUSED_RETRY_S = 1.5  # somebody must do something first: pair, or set up; or a handshake was cut in the middle
GREETED_WITHIN_NS = 1_500_000_000  # a hello that was lost on the way must not cost more than a new connection
TICK_S = 0.025
# Heartbeats are answered before anything else is sent. So late an answer, and the robot spoke on for so long with so
# many messages: it does not hear us. After a stall of the network all comes at once, and the answers right behind.
UNHEARD_AFTER_NS, UNHEARD_FOR_NS, UNHEARD_MESSAGES = 900_000_000, 250_000_000, 10
AUTO = "auto"  # as host: look for a robot
FIND_WITHIN_S = 2.0
ANSWER_WITHIN_S = 2.0
NO_ROBOT_FOUND = (
    "no robot makes itself known in this network; start robot-server with --host 0.0.0.0 there, or give its HOST:PORT"
)
# What is sent first when several things are due. Each kind has room for one: the newest wins.
SENDING_ORDER: tuple[type, ...] = (Prove, Join, Stop, Hijack, Drive, PanTilt, Heartbeat, Received)


class LinkListener(Protocol):
    """What a link tells. Called on the event loop: return at once, hand computing to others."""

    def on_connected(self, hello: Hello) -> None: ...

    def on_disconnected(self, reason: str) -> None: ...

    def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
        """A camera image and the station's monotonic time of its arrival."""
        ...

    def on_imu(self, batch: ImuBatch) -> None: ...

    def on_gap(self, num_samples: int) -> None:
        """IMU samples are missing between the last batch and the next one."""
        ...

    def on_drive_applied(self, applied: DriveApplied) -> None: ...

    def on_status(self, status: Status) -> None: ...

    def on_notice(self, notice: ErrorNotice) -> None:
        """The robot refused something, or a device failed."""
        ...


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
        find: Callable[[float], tuple[str, int] | None] | None = None,
        robots: PairedRobots | None = None,
    ) -> None:
        """`robots`: who is paired with this station; None: robots are met without TLS wherever they are."""
        self._find = find if find is not None or host != AUTO else _find_in_network
        self._host = host
        self._port = port
        self._listener = listener
        self._station_name = station_name
        self._now_ns = now_ns
        self._robots = robots
        self._connection: Connection | None = None
        self._retry_s = RETRY_S
        self._session = Session("station", now_ns())
        self._due: dict[type, StationMessage] = {}
        self._wake = asyncio.Event()
        self._silence = asyncio.Event()
        self._seq = 0  # of drive, stop and heartbeat
        self._connected = False
        self._reason = "not connected yet"
        self._hello: Hello | None = None
        self._next_imu_sequence = -1
        self._newest_frame = -1
        self._clock = LinkClock()
        self._rates = RateMeter()
        self._connections = 0
        self._bytes = self._frames = self._frames_skipped = 0
        self._imu_samples = self._imu_gaps = self._imu_lost = 0
        self._status: Status | None = None
        self._notice: ErrorNotice | None = None
        self._answer: asyncio.Future[ErrorNotice | None] | None = None  # somebody waits for what the robot says
        self._answer_seq = 0  # of the heartbeat behind the question
        self._heard_us_ns = 0  # when the last heartbeat was answered
        self._unanswered = 0  # messages that came when an answer was late already
        self._unanswered_since_ns = 0  # when the first of them came

    @property
    def state(self) -> LinkState:
        """What is known of the link now."""
        frame_rate_hz, imu_rate_hz, bytes_per_s = self._rates.rates()
        return LinkState(
            host=self._host,
            port=self._port,
            connected=self._connected,
            quiet=self._connected and self._session.state is State.QUIET,
            hello=self._hello,
            reason="" if self._connected else self._reason,
            connections=self._connections,
            rtt_ms=None if self._clock.rtt_ns is None else self._clock.rtt_ns * 1e-6,
            clock_offset_ns=self._clock.offset_ns(self._now_ns()),
            clock_drift_ppm=self._clock.drift_ppm,
            frame_rate_hz=frame_rate_hz,
            imu_rate_hz=imu_rate_hz,
            received_bytes_per_s=bytes_per_s,
            frames=self._frames,
            frames_skipped=self._frames_skipped,
            imu_samples=self._imu_samples,
            imu_gaps=self._imu_gaps,
            imu_lost=self._imu_lost,
            status=self._status,
            notice=self._notice,
        )

    def to_station_ns(self, t_robot_ns: int) -> int | None:
        """The station's monotonic time of a robot time; None before the clocks are known."""
        return self._clock.to_station_ns(t_robot_ns)

    # Commands

    def drive(self, linear: float, angular: float, ttl_ms: int) -> bool:
        """Hold a velocity (m/s, rad/s) for `ttl_ms` (above the protocol's limit: the limit); newest wins.

        Returns False, and sends nothing, when no robot is connected or it cannot drive.
        Raises LocalProtocolError when a number is not finite or out of the protocol's range.
        """
        ttl_ms = max(1, min(ttl_ms, MAX_DRIVE_TTL_MS))
        try:
            command = Drive(
                seq=self._count(), t_station_ns=self._now_ns(), linear=linear, angular=angular, ttl_ms=ttl_ms
            )
        except ValueError as exc:
            raise LocalProtocolError(f"drive command refused: {exc}") from exc
        return self._can("drive") and self._put(command)

    def stop(self) -> bool:
        """Motors off now. False when no robot is connected (its own watchdog has stopped it by then)."""
        self._due.pop(Drive, None)
        return self._connected and self._put(Stop(seq=self._count()))

    def point(self, pan: float, tilt: float) -> bool:
        """Point the camera head (rad, positive left and up); newest wins. False when there is none."""
        try:
            command = PanTilt(pan=pan, tilt=tilt)
        except ValueError as exc:
            raise LocalProtocolError(f"pan-tilt command refused: {exc}") from exc
        return self._can("pan_tilt") and self._put(command)

    async def hijack(self, spot: tuple[float, float, float] | None) -> ErrorNotice | None:
        """Put a simulated robot down elsewhere: x m, y m, yaw rad, or None for a spot of its own choice.

        Returns why the robot refused, or None when it did as it was asked. Raises NoRobot when it said neither.
        """
        x, y, yaw = spot or (0.0, 0.0, 0.0)
        try:
            command = Hijack(x=x, y=y, yaw=yaw, anywhere=spot is None)
        except ValueError as exc:
            raise LocalProtocolError(f"hijack refused: {exc}") from exc
        if not self._can("hijack"):
            raise NoRobot("the robot is not connected just now; the link comes back by itself")
        # A robot speaks only to refuse, and in order: the answer to a heartbeat behind the question says it did not.
        self._answer = answer = asyncio.get_running_loop().create_future()
        self._put(command)
        self._beat()
        self._answer_seq = self._seq
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                return await answer
        except TimeoutError as exc:
            raise NoRobot("the robot did not answer; the link comes back by itself") from exc
        finally:
            if self._answer is answer:
                self._answer = None

    def _answered(self, refusal: ErrorNotice | None) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_result(refusal)

    def _can(self, capability: str) -> bool:
        return self._connected and self._hello is not None and bool(getattr(self._hello.capabilities, capability))

    def _put(self, message: StationMessage) -> bool:
        self._due[type(message)] = message
        self._wake.set()
        return True

    def _count(self) -> int:
        self._seq += 1
        return self._seq

    # Connection

    async def run(self) -> None:
        """Connect, and connect again whenever the connection is lost, until cancelled."""
        while True:
            was_connected = False
            self._retry_s = RETRY_S
            try:
                self._reason = await self._connect_once()
            finally:
                was_connected, self._connected = self._connected, False
                self._rates = RateMeter()  # nothing arrives now
            if was_connected:
                logger.warning("robot lost: %s", self._reason)
                self._listener.on_disconnected(self._reason)
            await asyncio.sleep(self._retry_s)

    async def _connect_once(self) -> str:
        """Connect and stay connected; returns the sentence why not any longer."""
        if self._find is not None:
            found = await asyncio.to_thread(self._find, FIND_WITHIN_S)
            if found is None:
                return NO_ROBOT_FOUND
            self._host, self._port = found
        address = f"{self._host}:{self._port}"
        try:
            async with asyncio.timeout(CONNECT_WITHIN_S):
                connection = await connect(self._host, self._port, self._robots)
        except TimeoutError:
            self._retry_s = 0.0  # it has waited long enough; what was lost on the way does not come any more
            return f"no answer from {address}; check that the robot is on and in this network"
        except OSError as exc:
            return f"{in_words(exc, address)}; start robot-server there"
        except (ConnectionRefused, ConfigError) as exc:
            self._retry_s = REFUSED_RETRY_S
            return str(exc)
        except UnicodeError as exc:  # no name that DNS could hold, such as a..b
            logger.info("%s: %s", self._host, exc)
            return f"{self._host} is no host name; give --robot HOST:PORT"
        writer = connection.writer
        self._connection = connection
        self._session = Session("station", self._now_ns(), join_within_ns=GREETED_WITHIN_NS)
        self._due.clear()
        self._silence.clear()
        self._seq = 0
        # No task group: of an end and a cancellation in the same moment it reports the end only (until Python 3.13).
        tasks = [
            asyncio.create_task(part)
            for part in (
                self._read(connection.reader),
                self._write(writer),
                self._tick(),
                self._look_for_another_way(),
            )
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            writer.transport.abort()
            ends = await asyncio.gather(*tasks, return_exceptions=True)
        for end in ends:
            if isinstance(end, OSError):
                self._session.close(Event.LOST, f"connection lost: {in_words(end, address)}")
            elif isinstance(end, Exception) and not isinstance(end, _Ended):
                raise end
        return self._session.close_reason

    async def _read(self, reader: asyncio.StreamReader) -> None:
        session = self._session
        while data := await reader.read(READ_BYTES):
            self._bytes += len(data)
            session.receive(data)
            try:
                while (message := session.next_message(self._now_ns())) is not None:
                    self._take(message, self._now_ns())
                    if session.state is State.CLOSED:
                        raise _Ended
            except RemoteProtocolError as exc:
                raise _Ended from exc  # the session holds the reason
        session.close(Event.LOST, "the robot closed the connection")
        raise _Ended

    async def _write(self, writer: asyncio.StreamWriter) -> None:
        writer.transport.set_write_buffer_limits(high=1, low=0)  # 0 would pause a TLS transport for ever
        while True:
            await self._wake.wait()
            self._wake.clear()
            while (kind := next((kind for kind in SENDING_ORDER if kind in self._due), None)) is not None:
                message = self._due.pop(kind)
                if self._session.state is State.CLOSED:
                    raise _Ended  # the reader saw the end while we waited: what was due is said to nobody
                writer.write(self._session.send(message))
                await writer.drain()

    async def _tick(self) -> None:
        session = self._session
        while True:
            now_ns = self._now_ns()
            for duty in session.tick(now_ns):
                if duty is Tick.SEND_HEARTBEAT:
                    self._beat()
                    self._confirm()
                elif duty is Tick.WENT_QUIET:
                    self._silence.set()
                elif duty is Tick.CLOSE:
                    self._retry_s = 0.0
                    raise _Ended
            if self._is_unheard(now_ns):
                self._silence.set()
            self._rates.sample(now_ns, self._frames, self._imu_samples, self._bytes)
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
                num_bytes = self._bytes  # half a message that trickles is life enough
                is_there = await answers(self._host, self._port, self._robots)
                is_silent = session.state is State.QUIET and self._bytes == num_bytes
                if is_there and (is_silent or self._is_unheard(self._now_ns())):
                    self._retry_s = 0.0
                    what = "carries nothing any more" if is_silent else "does not reach the robot any more"
                    session.close(Event.LOST, f"the connection {what}, and the robot answers a new one")
                    raise _Ended
                await asyncio.sleep(RETRY_S)

    def _is_unheard(self, now_ns: int) -> bool:
        """The robot speaks and does not answer: what we say is lost, or its end waits for the rest of something."""
        speaks_on = now_ns - self._unanswered_since_ns >= UNHEARD_FOR_NS
        return self._connected and speaks_on and self._unanswered >= UNHEARD_MESSAGES

    # What arrives

    def _take(self, message: Message, now_ns: int) -> None:
        if now_ns - self._heard_us_ns >= UNHEARD_AFTER_NS:
            if self._unanswered == 0:
                self._unanswered_since_ns = now_ns
            self._unanswered += 1
        match message:
            case CameraFrame():
                self._frames += 1
                self._frames_skipped += message.skipped
                self._newest_frame = message.seq
                self._confirm()
                self._listener.on_frame(message, now_ns)
            case ImuBatch():
                self._take_imu(message)
            case DriveApplied():
                self._clock.add_stamp(message.t_robot_ns, now_ns)
                self._listener.on_drive_applied(message)
            case HeartbeatReply():
                self._heard_us_ns, self._unanswered = now_ns, 0
                self._clock.add_reply(message, now_ns)
                if message.seq >= self._answer_seq:
                    self._answered(None)
            case Status():
                self._status = message
                self._listener.on_status(message)
            case ErrorNotice():
                self._take_notice(message)
            case Hello():
                self._take_hello(message)
            case Welcome():
                self._connected = True
                self._connections += 1
                self._heard_us_ns, self._unanswered = now_ns, 0
                self._beat()  # at once: the robot needs something to tell late commands by
                if self._hello is not None:
                    self._listener.on_connected(self._hello)
            case Refusal():
                self._retry_s = REFUSED_RETRY_S if self._hello is not None and self._hello.challenge else RETRY_S
                self._session.close_reason = f"the robot refused this station: {message.reason}"
            case _:
                pass

    def _beat(self) -> None:
        self._put(Heartbeat(seq=self._count(), t_station_ns=self._now_ns()))

    def _confirm(self) -> None:
        self._put(Received(frame_seq=self._newest_frame, next_imu_sequence=self._next_imu_sequence))

    def _take_hello(self, hello: Hello) -> None:
        is_same_run = self._hello is not None and self._hello.session_id == hello.session_id
        if not is_same_run:  # another count of samples, and perhaps another clock
            self._next_imu_sequence = -1
            self._newest_frame = -1
            self._clock = LinkClock()
        self._hello = hello
        connection = self._connection
        if hello.challenge and connection is not None and connection.token is not None:
            proof = prove(connection.token, hello.challenge, connection.fingerprint)
            self._put(Prove(token_id=connection.token.id, proof=proof))
        self._put(
            Join(
                protocol=PROTOCOL_VERSION,
                station_name=self._station_name,
                resume_session_id=hello.session_id if is_same_run else "",
                next_imu_sequence=self._next_imu_sequence,
            )
        )

    def _take_imu(self, batch: ImuBatch) -> None:
        if self._next_imu_sequence >= 0 and batch.first_sequence > self._next_imu_sequence:
            missing = batch.first_sequence - self._next_imu_sequence
            self._imu_gaps += 1
            self._imu_lost += missing
            self._listener.on_gap(missing)
        self._next_imu_sequence = batch.next_sequence
        self._imu_samples += len(batch.samples)
        self._listener.on_imu(batch)

    def _take_notice(self, notice: ErrorNotice) -> None:
        self._notice = notice
        logger.warning("robot: %s", notice.message)
        if notice.about == "hijack":
            self._answered(notice)
        if notice.fatal:
            self._session.close_reason = f"the robot closed the connection: {notice.message}"
        self._listener.on_notice(notice)


def _find_in_network(seconds: float) -> tuple[str, int] | None:
    # Imported only here: zeroconf opens sockets of its own, and who gives an address does not need it.
    from station.robots.discovery import find_robot

    return find_robot(seconds)


class _Ended(Exception):
    """Ends the tasks of a connection; the session holds the reason."""
