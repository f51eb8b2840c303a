"""The UDP port beside the TCP one: pictures leave, stations' reports and commands come; strangers are ignored."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import socket
from collections.abc import Callable

from robot.datagram_sender import Address
from robot.station_client import StationClient
from shared.datagram_socket import waiting_datagrams
from shared.datagrams import KEY_BYTES, session_of
from shared.messages import AskDatagrams, Datagrams, StationDatagram

logger = logging.getLogger(__name__)

THIN_FOR_NS = 60_000_000_000  # a station that is back sooner is not asked to find out again that its network is thin


class DatagramPort:
    """Hands datagrams to the station whose session they name, where they come from its connection's own address."""

    def __init__(
        self, now_ns: Callable[[], int], on_message: Callable[[StationClient, StationDatagram, int], None]
    ) -> None:
        """`on_message` gets what a station says by datagram, and when it was read."""
        self._now_ns = now_ns
        self._on_message = on_message
        self._left_thin_ns: dict[str, int] = {}  # host → when its connection over a thin network ended
        self.number = 0  # 0: there is none
        self._socket: socket.socket | None = None
        self._clients: dict[int, StationClient] = {}

    def open(self, listener: socket.socket) -> None:
        """Take the port of the same number as the listener's; without it there are no datagrams."""
        address = listener.getsockname()
        try:
            self._socket = socket.socket(listener.family, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.bind(address)
        except OSError as exc:
            logger.warning("UDP port %d cannot be used (%s): pictures go over TCP alone", address[1], exc.strerror)
            self.close()
            return
        self.number = address[1]
        asyncio.get_running_loop().add_reader(self._socket, self._read, self._socket)

    def close(self) -> None:
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
        self._socket, self.number = None, 0

    def answer(self, client: StationClient, ask: AskDatagrams) -> None:
        """With new keys, once for each connection."""
        if self._socket is None or client.datagrams is not None or client.video is None:
            return
        client.video.is_thin |= self._left_thin_ns.get(client.address, -THIN_FOR_NS) > self._now_ns() - THIN_FOR_NS
        session = secrets.randbits(32)
        while session in self._clients:
            session = secrets.randbits(32)
        keys = [secrets.token_bytes(KEY_BYTES) for _ in range(2)]
        told = Datagrams(session=session, key_to_station=keys[0], key_to_robot=keys[1])
        self._clients[session] = client
        client.open_datagrams(
            told, ask.port, self._send, lambda message, read_ns: self._on_message(client, message, read_ns)
        )

    def forget(self, client: StationClient) -> None:
        now_ns = self._now_ns()
        self._left_thin_ns = {h: t_ns for h, t_ns in self._left_thin_ns.items() if t_ns > now_ns - THIN_FOR_NS}
        if client.datagrams is not None and client.video is not None and client.video.is_thin:
            self._left_thin_ns[client.address] = now_ns
        self._clients = {session: known for session, known in self._clients.items() if known is not client}

    def _read(self, port: socket.socket) -> None:
        for datagram, address in waiting_datagrams(port):
            client = self._clients.get(session_of(datagram))
            if client is not None and client.datagrams is not None:
                client.datagrams.receive(datagram, address)

    def _send(self, datagram: bytes, address: Address) -> None:
        """What finds no room is lost, as on the way."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(datagram, address)
