"""The station's end of datagrams: a UDP socket, pictures that come, reports of them and commands that go."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable
from typing import Any

from shared.datagram_socket import waiting_datagrams
from shared.datagrams import Opener, Sealer
from shared.errors import RemoteProtocolError
from shared.message_codec import decode_robot_message, encode_message
from shared.messages import (
    AskDatagrams,
    CameraFrame,
    DatagramReport,
    Datagrams,
    Drive,
    HeartbeatReply,
    PictureArrival,
    StationDatagram,
    Stop,
)
from shared.picture_pieces import MESSAGE, PIECE, ArrivingPicture, Assembler

logger = logging.getLogger(__name__)

OPENS_WITHIN_REPORTS = 50  # five seconds: until something comes they are those of heartbeats
RECEIVE_BYTES = 1 << 20  # of the kernel's buffer: a busy moment of ours must not lose what the network carried


class PictureDatagrams:
    """Takes a robot's datagrams in, of one connection. All methods belong on the event loop.

    Reports begin when the robot's keys are here, whether or not anything has come: a firewall lets the answers in.
    """

    def __init__(
        self,
        robot: tuple[Any, ...],
        on_frame: Callable[[CameraFrame, int], None],
        on_reply: Callable[[HeartbeatReply, int], None],
        now_ns: Callable[[], int],
    ) -> None:
        """`robot`: its address as sockets name it, with the port that its hello tells. Raises OSError."""
        self.num_bytes = self.num_datagrams = 0  # that came
        self._robot = robot
        self._on_frame = on_frame
        self._on_reply = on_reply
        self._now_ns = now_ns
        self._sealer: Sealer | None = None
        self._opener: Opener | None = None
        self._assembler = Assembler()
        self._num_reports = 0
        self._reported = -1  # the newest picture whose end was reported
        self._command: Drive | Stop | None = None  # the newest, said once so far
        family = socket.AF_INET6 if len(robot) == 4 else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        self._socket.bind(("", 0))
        asyncio.get_running_loop().add_reader(self._socket, self._read)

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()

    def question(self) -> AskDatagrams:
        return AskDatagrams(port=self._socket.getsockname()[1])

    @property
    def is_blocked(self) -> bool:
        """The robot should have been heard by now: a firewall, or a container without the port."""
        return self._num_reports >= OPENS_WITHIN_REPORTS and self.num_datagrams == 0

    @property
    def why_blocked(self) -> str:
        return f"no datagram comes from UDP port {self._robot[1]} of the robot"

    def begin(self, told: Datagrams) -> None:
        """The robot's answer."""
        self._sealer = Sealer(told.key_to_robot, told.session)
        self._opener = Opener(told.key_to_station, told.session)
        self.report()

    def report(self) -> None:
        """Tell the robot what has come. Every 100 ms, and after each picture."""
        if self._sealer is None or self._opener is None:
            return
        self._num_reports += 1
        if self._num_reports == OPENS_WITHIN_REPORTS and self.is_blocked:
            logger.warning("%s: pictures come over TCP alone, and late where packets are lost", self.why_blocked)
        now_ns = self._now_ns()
        report = DatagramReport(
            seq=self._num_reports,
            t_station_ns=now_ns,
            newest=self._opener.newest,
            pictures=tuple(_arrival(picture, now_ns) for picture in self._assembler.newest),
        )
        self._send(report)

    def command(self, command: Drive | Stop) -> None:
        """Beside the connection, and again with the next tick: on a thin network one of them comes in time."""
        self._command = command
        self._send(command)

    def repeat_command(self) -> None:
        """Say the newest command a second time, unless that was done."""
        command, self._command = self._command, None
        if command is not None:
            self._send(command)

    def _send(self, message: StationDatagram) -> None:
        if self._sealer is None:
            return
        with contextlib.suppress(OSError):  # what finds no room is lost, as on the way
            self._socket.sendto(self._sealer.seal(encode_message(message)), self._robot)

    def _read(self) -> None:
        for datagram, _ in waiting_datagrams(self._socket):
            self._receive(datagram)

    def _receive(self, datagram: bytes) -> None:
        content = None if self._opener is None else self._opener.open(datagram)
        if not content:
            return
        now_ns = self._now_ns()
        self.num_bytes += len(datagram)
        self.num_datagrams += 1
        if content[0] == MESSAGE:
            if isinstance(reply := _decoded(content[1:]), HeartbeatReply):
                self._on_reply(reply, now_ns)
        elif content[0] == PIECE:
            whole = self._assembler.add(content, now_ns)
            self._report_ends()
            if whole is not None and isinstance(frame := _decoded(whole), CameraFrame):
                self._on_frame(frame, now_ns)

    def _report_ends(self) -> None:
        """As soon as a picture's last piece is here, or one of the next picture."""
        pictures = self._assembler.newest
        if not pictures:
            return
        newest = pictures[-1]
        has_ended = newest.last_piece == newest.num_pieces + newest.num_parity - 1
        ended = newest.picture if has_ended else newest.picture - 1
        if ended > self._reported:
            self._reported = ended
            self.report()


def _arrival(picture: ArrivingPicture, now_ns: int) -> PictureArrival:
    return PictureArrival(
        picture=picture.picture,
        count=picture.count,
        first_piece=picture.first_piece,
        first_held_ns=now_ns - picture.first_ns,
        last_piece=picture.last_piece,
        last_held_ns=now_ns - picture.last_ns,
    )


def _decoded(payload: bytes) -> object:
    """None: no message; a robot of ours sends none such."""
    try:
        return decode_robot_message(payload)
    except RemoteProtocolError as exc:
        logger.debug("a datagram is ignored: %s", exc)
        return None
