"""Sends one station's pictures by datagrams where its connection is too thin for them, and back where none arrives."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from robot.datagram_path import DatagramPath
from robot.link_meter import LinkMeter
from robot.video import VideoStream
from shared.messages import CameraFrame, DatagramReport, Datagrams, HeartbeatReply, StationDatagram
from shared.session import HEARTBEAT_INTERVAL_NS

logger = logging.getLogger(__name__)

Address = tuple[str | int, ...]
PACED_TOGETHER = 4  # datagrams, 5 kB; a queue on the way that drops what comes at once holds more
PACED_AT = 2.0  # times what the link carries: at less the link would never be seen to carry more
OPENS_WITHIN_BEATS = 10_000_000_000 // HEARTBEAT_INTERVAL_NS  # on a bad link the keys are under way for seconds


class DatagramSender:
    """Belongs to a connection, and has what is chosen there: the stream of pictures."""

    def __init__(
        self,
        told: Datagrams,
        address: Address,
        video: VideoStream,
        connection: LinkMeter,
        send: Callable[[bytes, Address], None],
        send_whole: Callable[[CameraFrame], None],
        on_message: Callable[[StationDatagram, int], None],
        now_ns: Callable[[], int],
        clock: Callable[[], int],
    ) -> None:
        """
        Args:
            address: where the station listens; its network may let it appear at another port of the same host.
            send_whole: sends a picture by the connection.
            on_message: gets what the station says, and when it was read.
            now_ns, clock: as for a StationClient.
        """
        self.path = DatagramPath(told)
        self.is_used = False
        self._address = address
        self._video = video
        self._connection = connection
        self._send = send
        self._send_whole = send_whole
        self._on_message = on_message
        self._now_ns = now_ns
        self._clock = clock
        self._wake = asyncio.Event()
        self._beats = 0
        self._has_failed = False  # and it was said

    def wake(self) -> None:
        """There may be something new to send."""
        self._wake.set()

    def receive(self, datagram: bytes, address: Address) -> None:
        """Something came to our port that names this session."""
        if address[0] != self._address[0]:
            return
        now_ns, t_robot_ns = self._now_ns(), self._clock()
        if (report := self.path.receive(datagram, now_ns)) is None:
            return
        self._on_message(report, now_ns)
        if not isinstance(report, DatagramReport):
            return
        self._address = address
        self._reply(report.seq, report.t_station_ns, t_robot_ns)
        self._video.confirm(self.path.newest_over)
        self._choose()
        self._wake.set()

    def note_beat(self, reply: HeartbeatReply, read_ns: int) -> None:
        """A heartbeat came by the connection. Until the way is open it is answered here too: that opens firewalls."""
        self._beats += 1
        self.path.note_beat(read_ns)
        if not self.path.is_open:
            self._reply(reply.seq, reply.t_station_ns, reply.t_robot_received_ns)
        self._choose()

    def _reply(self, seq: int, t_station_ns: int, t_robot_ns: int) -> None:
        reply = HeartbeatReply(
            seq=seq, t_station_ns=t_station_ns, t_robot_received_ns=t_robot_ns, t_robot_sent_ns=self._clock()
        )
        self._send(self.path.reply(reply), self._address)

    def _choose(self) -> None:
        """Datagrams, from when the connection was too thin on: a good one costs less of the processor than they do."""
        is_open = self.path.is_open
        if self._video.is_thin and not is_open and self._beats >= OPENS_WITHIN_BEATS and not self._has_failed:
            self._has_failed = True
            logger.warning("no datagram reaches %s: its pictures go over TCP, and late where packets are lost", self)
        if self.is_used != (self._video.is_thin and is_open):
            self.is_used = not self.is_used
            self._video.change_way(self.path.meter if self.is_used else self._connection)
            logger.info("pictures go to %s by %s", self, "datagrams" if self.is_used else "TCP")

    def __str__(self) -> str:
        return f"{self._address[0]} port {self._address[1]}"

    async def run(self) -> None:
        """Send what is due, until cancelled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self.is_used and (frame := self._video.next_frame(self._now_ns())) is not None:
                await self._send_picture(frame)

    async def _send_picture(self, frame: CameraFrame) -> None:
        contents = self.path.cut(frame, self._now_ns())
        if contents is None:
            self._send_whole(frame)
            return
        estimate = self.path.meter.estimate
        pause_s = 0.0
        if estimate is not None:
            pause_s = len(frame.jpeg) / estimate.bytes_per_s / PACED_AT / len(contents) * PACED_TOGETHER
        for begin in range(0, len(contents), PACED_TOGETHER):
            if begin and pause_s:
                await asyncio.sleep(pause_s)
            for content in contents[begin : begin + PACED_TOGETHER]:
                self._send(self.path.seal(content), self._address)
        self.path.end_picture()
