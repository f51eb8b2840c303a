"""The API's connections: whose each is, and how long each phase of a request may take."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from uvicorn._types import ASGISendEvent
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode

from shared.reception import Caller
from shared.seats import Seats, rank_of
from station.access.visitors import Visitor
from station.errors import Busy

logger = logging.getLogger(__name__)
MAX_STRANGERS = 64  # connections on which nobody known has asked for anything
STRANGER_WITHIN_S = 60.0  # the page's files to who logs in, over a slow link
MAX_KNOWN = 256
CONNECTIONS_PER_TOKEN = 64  # a page has three sockets and a browser's six connections
MAX_HEAD_BYTES = 65_536
HEAD_WITHIN_S = 10.0  # from the end of the last request to the end of the next one's head
MAX_SENT_AHEAD = 8  # requests that wait for the answer to the one before them; browsers send none ahead
# What a WebSocket may say: a page says 4 kB a second, and all at once what waited in a network that froze for 16 s.
# Frames of six bytes cost as much as long ones: of more of them all others would wait.
SOCKET_BYTES_PER_S = 32_768
SOCKET_BURST_BYTES = 65_536
TAKEN_WITHIN_S = 30.0  # an answer of which the peer takes nothing for so long is not wanted
LOOK_S = 0.25
KEY = "connection"  # in the state of an ASGI scope


def descriptors_left() -> int:
    """How many more files and sockets this process may have open."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(0, limit - len(os.listdir("/proc/self/fd")))


class Connection:
    """One connection. In it requests come one after the other, or a WebSocket."""

    def __init__(self, caller: Caller, known: Seats, among: set[Connection]) -> None:
        self.caller = caller
        self._known = known
        self._among = among
        self._transport: asyncio.Transport | None = None
        self._is_serving = False
        self._head_bytes = 0
        self._said_bytes = 0.0  # by a socket, less what it might say since
        self._said_s = 0.0
        self._since_s = time.monotonic()  # when the present phase began, or last got on
        self._untaken = 0  # bytes of answers that the peer has not taken yet

    def made(self, transport: asyncio.Transport) -> None:
        """The handshake is done. Of one that fails nobody hears again, so it is not among the others before."""
        self._among.add(self)
        self._transport = transport
        self.caller.made(transport)

    def lost(self) -> None:
        self._among.discard(self)
        self.caller.left()

    def recognise(self, visitor: Visitor) -> None:
        """Somebody known asks. Raises Busy."""
        if not self.caller.know(self._known, visitor.holder, rank_of(visitor.role)):
            raise Busy("too many connections are open, none of which may be ended for yours; close some")

    @contextlib.contextmanager
    def serving(self) -> Iterator[None]:
        """While a request is answered, or a socket is open."""
        self._is_serving, self._head_bytes = True, 0
        try:
            yield
        finally:
            self._is_serving, self._since_s = False, time.monotonic()

    def end(self) -> None:
        """Close it behind what was sent."""
        if self._transport is not None:
            self._transport.close()

    def receive_unasked(self, count: int) -> None:
        """So many bytes came which belong to no request that is being answered."""
        self._head_bytes += count
        if self._head_bytes > MAX_HEAD_BYTES:
            self.caller.abort()

    def may_say(self, count: int, now_s: float) -> bool:
        """Whether so many bytes of a socket are taken. False: it floods, and is ended."""
        forgotten = SOCKET_BYTES_PER_S * (now_s - self._said_s)
        self._said_bytes, self._said_s = max(0.0, self._said_bytes - forgotten) + count, now_s
        if self._said_bytes > SOCKET_BURST_BYTES:
            self.caller.abort()
        return self._said_bytes <= SOCKET_BURST_BYTES

    def look(self, now_s: float) -> None:
        """End it when its phase takes too long."""
        assert self._transport is not None
        untaken = self._transport.get_write_buffer_size()
        if untaken != self._untaken or (self._is_serving and not untaken):
            self._untaken, self._since_s = untaken, now_s
        if now_s - self._since_s > (TAKEN_WITHIN_S if untaken else HEAD_WITHIN_S):
            self.caller.abort()


class Connections:
    """All of them."""

    def __init__(self) -> None:
        spare = descriptors_left()  # a quarter stays for recordings, workers and the link
        self.max_strangers = min(MAX_STRANGERS, max(4, spare // 4))
        self._known = Seats(min(MAX_KNOWN, max(8, spare // 2)), CONNECTIONS_PER_TOKEN, oldest_yields=True)
        self._open: set[Connection] = set()

    def open(self, caller: Caller) -> Connection:
        return Connection(caller, self._known, self._open)

    async def watch(self) -> None:
        """End those whose phase takes too long, until cancelled."""
        while True:
            await asyncio.sleep(LOOK_S)
            now_s = time.monotonic()
            for connection in list(self._open):
                connection.look(now_s)


class HttpProtocol(HttpToolsProtocol):
    """Uvicorn's own, which tells its connection what happens to it."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        stream = cast(asyncio.Transport, transport)  # of TCP
        connection_of(self.app_state).made(stream)
        super().connection_made(stream)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.cycle is None or self.cycle.response_complete:
            connection_of(self.app_state).receive_unasked(len(data))

    def on_headers_complete(self) -> None:
        """Take the next request. Uvicorn keeps all that are sent ahead: of 18 bytes each, as objects of kilobytes."""
        if len(self.pipeline) >= MAX_SENT_AHEAD:
            raise _SentAhead
        super().on_headers_complete()

    def send_400_response(self, msg: str) -> None:
        """Answer what is no request; while others wait for their answers, end the connection with the last of these."""
        if self.cycle is None or self.cycle.response_complete:
            super().send_400_response(msg)
            return
        self.cycle.keep_alive = False
        self.flow.pause_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        connection_of(self.app_state).lost()
        super().connection_lost(exc)


class _SentAhead(Exception):
    """Ends the reading of a connection."""


class SocketProtocol(WebSocketsSansIOProtocol):
    """What the connection speaks from when it has become a WebSocket."""

    def data_received(self, data: bytes) -> None:
        if not self.handshake_initiated or connection_of(self.app_state).may_say(len(data), time.monotonic()):
            super().data_received(data)

    def send_receive_event_to_app(self) -> None:
        """Hand a message on, or end the socket whose text is none. Uvicorn would log that with a traceback."""
        if self.curr_msg_data_type == "text" and not self.close_sent and not _is_text(self.frames):
            logger.warning("a WebSocket's text was no UTF-8: it is closed")
            self.frames = []
            self.conn.send_close(CloseCode.INVALID_DATA)
            self.handle_parser_exception()
            return
        super().send_receive_event_to_app()

    async def send(self, message: ASGISendEvent) -> None:
        await super().send(message)
        if self.close_sent:
            # A refusal by HTTP ends the handshake. Uvicorn forgets to note it, and would log an error for each.
            self.handshake_complete = True

    def connection_lost(self, exc: Exception | None) -> None:
        connection_of(self.app_state).lost()
        super().connection_lost(exc)


def _is_text(frames: Sequence[bytes | bytearray]) -> bool:
    try:
        b"".join(frames).decode()
    except UnicodeDecodeError:
        return False
    return True


def connection_of(state: Mapping[str, Any]) -> Connection:
    """The connection of a protocol or an ASGI scope."""
    return cast(Connection, state[KEY])
