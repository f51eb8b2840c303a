"""What one caller may ask of the station at once: bytes in a body, sockets and streams that stay open."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from fastapi import Request, WebSocket, WebSocketDisconnect
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from station.api.problems import problem
from station.errors import Busy

MAX_BODY_BYTES = 1 << 20  # the largest request, a list of navigations, has some kilobytes
MAX_SOCKETS = 32  # of each kind: a page has three
MAX_STREAMS = 16  # MJPEG viewers: each gets every picture
UNSUPPORTED = 1003
TRY_AGAIN_LATER = 1013
TOO_LARGE = f"a request may have {MAX_BODY_BYTES} bytes; send less"


class BodyLimit:
    """ASGI middleware: a request with a larger body ends in 413, before more of it is kept."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        length = request.headers.get("content-length", "")
        if length.isdecimal() and int(length) > MAX_BODY_BYTES:
            await problem(request, 413, "too-large", "Too large", TOO_LARGE)(scope, receive, send)
            return
        received = 0

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > MAX_BODY_BYTES:  # it did not say how long it is
                raise HTTPException(413, TOO_LARGE)
            return message

        await self._app(scope, counted, send)


class Seats:
    """How many sockets and streams of each kind are open."""

    def __init__(self) -> None:
        self._taken: Counter[str] = Counter()

    @contextmanager
    def take(self, kind: str, limit: int) -> Iterator[None]:
        """One of `limit` seats. Raises Busy when all are taken."""
        if self._taken[kind] >= limit:
            raise Busy(f"{limit} viewers of {kind} are connected, more are not allowed; close one")
        self._taken[kind] += 1
        try:
            yield
        finally:
            self._taken[kind] -= 1


@contextmanager
def seated(socket: WebSocket) -> Iterator[None]:
    """A seat for an accepted socket. Raises Busy; `refuse` tells the peer."""
    seats: Seats = socket.app.state.seats
    with seats.take(socket.url.path, MAX_SOCKETS):
        yield


async def refuse(socket: WebSocket, busy: Busy) -> None:
    """Close with the sentence why."""
    await socket.close(TRY_AGAIN_LATER, str(busy))


async def receive_text(socket: WebSocket) -> str:
    """The next text. Raises WebSocketDisconnect; a binary message closes the socket with a sentence."""
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000), message.get("reason"))
    text: str | None = message.get("text")
    if text is None:
        await socket.close(UNSUPPORTED, "this socket takes text, not binary messages")
        raise WebSocketDisconnect(UNSUPPORTED)
    return text
