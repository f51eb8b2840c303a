"""One station's connection, seen from the robot. It has its own cursors, so a slow station never slows another."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable

import msgspec

from robot.commands import notice
from robot.datagram_sender import Address, DatagramSender
from robot.depth import DepthStream
from robot.link_meter import LinkMeter
from robot.outbox import ImuCursor
from robot.video import VideoStream
from shared.access import Role
from shared.errors import RemoteProtocolError
from shared.listening import is_loopback
from shared.messages import (
    CameraFrame,
    Datagrams,
    DriveApplied,
    ErrorNotice,
    HeartbeatReply,
    Join,
    Message,
    Paired,
    Received,
    Refusal,
    StationDatagram,
    StationMessage,
)
from shared.pairing import Pake
from shared.reception import Caller
from shared.session import MESSAGES_AT_A_TIME, Event, Session, State, Tick

logger = logging.getLogger(__name__)

MAX_QUEUED_MESSAGES = 512  # 20 s of drive reports; beyond it the oldest go, counted
READ_BYTES = 65536
LAST_WORD_WITHIN_S = 1.0  # a peer that does not read must not hold up the closing


class _Ended(Exception):
    """Ends the tasks of a connection; the session holds the reason."""


class StationClient:
    """Reads commands and writes what is due, one message at a time, most urgent first."""

    def __init__(
        self,
        client_id: int,
        caller: Caller,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        now_ns: Callable[[], int],
        clock: Callable[[], int],
    ) -> None:
        """`now_ns` is the program's monotonic clock, `clock` the robot's, which may be a recording's."""
        self.id = client_id
        self.caller = caller
        self.station_name = ""
        self.knows_calibration_changed = False
        self._peer = writer.get_extra_info("peername") or ("?", 0)  # asyncio forgets it when TLS ends
        self.address = str(self._peer[0])
        self.challenge = b""  # what this connection must answer; empty: no access control
        self.role: Role | None = None  # None: who it is is not known yet
        self.token_id = ""
        self.pairing: tuple[Pake, str] | None = None  # the exchange so far, and the station's name
        self.imu: ImuCursor | None = None
        self.meter = LinkMeter()
        self.video: VideoStream | None = None
        self.depth: DepthStream | None = None
        self.datagrams: DatagramSender | None = None
        self.messages_dropped = 0
        self.read_ns = now_ns()  # when the bytes now being taken in were read
        self.session = Session("robot", now_ns())
        self._reader = reader
        self._writer = writer
        self._now_ns = now_ns
        self._clock = clock
        self._queue: deque[Message] = deque()
        self._tasks: asyncio.TaskGroup | None = None
        self._wake = asyncio.Event()
        self._ending = asyncio.Event()
        self._last_word = b""
        # Everything waits in our own queues, where it can be skipped and counted, not in the transport's.
        writer.transport.set_write_buffer_limits(high=1, low=0)  # 0 would pause a TLS transport for ever

    @property
    def is_joined(self) -> bool:
        """Whether it takes part: gets data, may command."""
        return self.session.state in (State.ACTIVE, State.QUIET)

    @property
    def has_all(self) -> bool:
        """Whether all sensor data have been sent to it."""
        return all(stream is None or stream.is_at_end for stream in (self.imu, self.video, self.depth))

    def confirm(self, received: Received) -> None:
        """The station has taken something in: there is room for more on the way."""
        if self.imu is None or self.video is None:
            return
        self.imu.confirm(received.next_imu_sequence)
        num_frames = self.video.confirm(received.frame_seq)
        if received.num_bytes >= 0:
            self.meter.confirm(received.num_bytes, received.held_ns, self.read_ns, received.t_station_ns)
        else:
            for _ in range(num_frames):
                self.meter.confirm_frame(self.read_ns)
        self._wake.set()

    @property
    def is_on_this_machine(self) -> bool:
        return is_loopback(self.address)

    def wake(self) -> None:
        """There may be something new to send."""
        self._wake.set()
        if self.datagrams is not None:
            self.datagrams.wake()

    def put(self, message: Message) -> None:
        """Queue a message; when the queue is full, the oldest drive report goes."""
        if len(self._queue) >= MAX_QUEUED_MESSAGES:
            oldest = next((m for m in self._queue if isinstance(m, DriveApplied)), self._queue[0])
            self._queue.remove(oldest)
            self.messages_dropped += 1
        self._queue.append(message)
        self._wake.set()

    def open_datagrams(
        self,
        told: Datagrams,
        port: int,
        send: Callable[[bytes, Address], None],
        on_message: Callable[[StationDatagram, int], None],
    ) -> None:
        """Pictures may go to this port of the station's from now on, commands come. Once, after it has joined."""
        video, tasks = self.video, self._tasks
        if video is None or tasks is None:
            return
        self.put(told)
        address = (self._peer[0], port, *self._peer[2:])
        self.datagrams = DatagramSender(
            told, address, video, self.meter, send, self.put, on_message, self._now_ns, self._clock
        )
        tasks.create_task(self.datagrams.run())

    def end(self, event: Event, last_word: ErrorNotice | Refusal | Paired) -> None:
        """Close the connection, after telling the station why."""
        if self._ending.is_set():
            return
        self._last_word = self.session.send(last_word)
        match last_word:
            case ErrorNotice():
                self.session.close(event, last_word.message)
            case Refusal():
                self.session.close(event, last_word.reason)
            case Paired():
                pass  # said is done
        self._ending.set()

    def tick(self) -> bool:
        """Let time pass. True when the station just went quiet."""
        duties = self.session.tick(self._now_ns())
        if Tick.CLOSE in duties:
            self.end(Event.TIMED_OUT, notice("silent", self.session.close_reason, fatal=True))
        return Tick.WENT_QUIET in duties

    async def run(
        self,
        hello: Message,
        handle: Callable[[StationClient, Join | StationMessage], None],
        leave: Callable[[StationClient], None],
    ) -> None:
        """Serve this station until it leaves, breaks the rules, falls silent or `end` is called."""
        self.put(hello)
        try:
            async with asyncio.TaskGroup() as tasks:
                self._tasks = tasks
                tasks.create_task(self._write())  # the hello first, whatever the station has said already
                tasks.create_task(self._read(handle))
                tasks.create_task(self._wait_for_end())
        except* _Ended:
            pass
        except* OSError as group:
            self.session.close(Event.LOST, f"connection lost: {group.exceptions[0]}")
        finally:
            # However it ended: its last word may take a second, and a datagram of it must find no one.
            self.session.close(Event.LOST, "the connection ended")
            leave(self)  # before the last word, which may take a while: motors must not wait for it
            await self._close()

    async def _read(self, handle: Callable[[StationClient, Join | StationMessage], None]) -> None:
        num_messages = 0
        while data := await self._reader.read(READ_BYTES):
            self.read_ns = self._now_ns()
            self.session.receive(data)
            try:
                while not self._ending.is_set() and (message := self.session.next_message(self._now_ns())) is not None:
                    handle(self, message)  # type: ignore[arg-type]  # the session decodes station messages only
                    num_messages += 1
                    if num_messages % MESSAGES_AT_A_TIME == 0:
                        await asyncio.sleep(0)
            except RemoteProtocolError as exc:
                self.end(Event.BROKE_RULES, notice("protocol", str(exc), fatal=True))
                return
        self.session.close(Event.LOST, "the station closed the connection")
        raise _Ended

    async def _write(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while (message := self._next_message()) is not None:
                data = self.session.send(message)
                is_frame = isinstance(message, CameraFrame)
                self.meter.send(len(data), is_frame, self._now_ns())
                if self.datagrams is not None and not is_frame:
                    self.datagrams.path.meter.note_beside(len(data))
                if self._writer.is_closing():  # uvloop would call a write to it a programming error
                    raise ConnectionResetError("the station reset the connection")
                self._writer.write(data)
                await self._writer.drain()

    def _next_message(self) -> Message | None:
        """The most urgent message that is due: answers, reports, all IMU samples, depth in its turn, newest frame."""
        if self.session.state is State.CLOSED:
            return None
        if self._queue:
            message = self._queue.popleft()
            if isinstance(message, HeartbeatReply):  # it leaves now, whatever it waited behind
                message = msgspec.structs.replace(message, t_robot_sent_ns=self._clock())
            return message
        if self.imu is not None and (batch := self.imu.next_batch()) is not None:
            return batch
        if self.depth is not None and (depth := self.depth.next_depth(self._now_ns())) is not None:
            return depth
        if self.video is None or (self.datagrams is not None and self.datagrams.is_used):
            return None
        return self.video.next_frame(self._now_ns())

    async def _wait_for_end(self) -> None:
        await self._ending.wait()
        raise _Ended

    async def _close(self) -> None:
        try:
            async with asyncio.timeout(LAST_WORD_WITHIN_S):
                if self._last_word and not self._writer.is_closing():
                    self._writer.write(self._last_word)
                    await self._writer.drain()
                    if self._writer.can_write_eof():  # TLS cannot end one direction alone
                        self._writer.write_eof()
                    # Closing a socket with unread bytes resets it, and the peer would lose the last word.
                    while await self._reader.read(READ_BYTES):
                        pass
        except (OSError, TimeoutError):
            logger.debug("station %d did not take the last word", self.id)
        finally:
            self._writer.transport.abort()
