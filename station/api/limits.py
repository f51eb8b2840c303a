"""What one caller may ask of the station at once: bytes in a body, sockets and streams that stay open."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from fastapi import Request, WebSocket, WebSocketDisconnect
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from shared.seats import Seats, rank_of
from station.access.visitors import Visitor
from station.api.problems import problem
from station.errors import Busy

# The largest request, a list of navigations, has some kilobytes; to count the mistakes of 1 MiB took seconds.
MAX_BODY_BYTES = 1 << 16
MAX_SOCKETS = 32  # of each kind: a page has three
SOCKETS_PER_TOKEN = 8
MAX_STREAMS = 16  # MJPEG viewers: each gets every picture
STREAMS_PER_TOKEN = 4
REPLACED = 4409  # close code
UNSUPPORTED = 1003
TRY_AGAIN_LATER = 1013
GONE = (WebSocketDisconnect, RuntimeError)  # what reading and writing raise when the peer is not there any more


@dataclass(frozen=True, slots=True)
class BodyBounds:
    """How large a request's body may be, and how long it may take."""

    bytes: int
    within_s: float

    @property
    def too_large(self) -> str:
        return f"a request may have {self.bytes} bytes; send less"

    @property
    def too_slow(self) -> str:
        return f"a request's body is to come within {self.within_s:g} s; send it at once"


KNOWN_BODY = BodyBounds(MAX_BODY_BYTES, 20.0)
STRANGERS_BODY = BodyBounds(4096, 5.0)  # a token to log in with


class BodyLimit:
    """ASGI middleware: a larger body, or one that takes longer, ends in 413 or 408 before more of it is kept."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        limit = KNOWN_BODY if isinstance(request.state.visitor, Visitor) else STRANGERS_BODY
        length = request.headers.get("content-length", "")
        if length.isdecimal() and int(length) > limit.bytes:
            await problem(request, 413, "too-large", "Too large", limit.too_large)(scope, receive, send)
            return
        received, is_whole = 0, False
        loop = asyncio.get_running_loop()
        end_s = loop.time() + limit.within_s

        async def counted() -> Message:
            nonlocal received, is_whole
            if is_whole:  # the app waits for the peer to leave
                return await receive()
            try:
                async with asyncio.timeout_at(end_s):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(408, limit.too_slow) from None
            is_whole = not message.get("more_body", False)
            received += len(message.get("body", b""))
            if received > limit.bytes:  # it did not say how long it is
                raise HTTPException(413, limit.too_large)
            return message

        await self._app(scope, counted, send)


class Replaced(Exception):
    """A seat is another's now."""


class SeatsByKind:
    """The sockets and streams of each kind that are open."""

    def __init__(self) -> None:
        self._rooms: dict[str, Seats] = {}

    @contextlib.asynccontextmanager
    async def take(self, kind: str, limit: int, per_token: int, visitor: Visitor) -> AsyncIterator[None]:
        """One of `limit` seats, for as long as the body runs, which must leave it when it is cancelled.

        Raises Busy: none is free for this visitor; Replaced: another one got it, with the same token or one that may
        do more.
        """
        room = self._rooms.setdefault(kind, Seats(limit, per_token))
        try:
            async with asyncio.timeout(None) as stay:
                seat = room.take(visitor.holder, rank_of(visitor.role), lambda: stay.reschedule(0.0))
                if seat is None:
                    raise Busy(f"{limit} viewers of {kind} are connected, more are not allowed; close one")
                try:
                    yield
                finally:
                    room.leave(seat)
        except TimeoutError:
            if stay.expired():
                raise Replaced from None
            raise


async def converse(
    socket: WebSocket,
    hear: Callable[[], Awaitable[object]],
    *say: Callable[[], Coroutine[Any, Any, None]],
    leave: Callable[[], None] = lambda: None,
) -> None:
    """Accept a socket; `hear` again and again, while each `say` runs beside it, until the peer is gone. Then `leave`.

    Where no seat is free nothing of it happens: the socket is closed with the sentence why.
    """
    await socket.accept()
    seats: SeatsByKind = socket.app.state.seats
    try:
        async with seats.take(socket.url.path, MAX_SOCKETS, SOCKETS_PER_TOKEN, socket.state.visitor):
            saying = [asyncio.create_task(one()) for one in say]
            try:
                while True:
                    await hear()
            except GONE:
                pass
            finally:
                leave()  # first: it may stop a robot, and what is said besides may have failed
                for task in saying:
                    task.cancel()
                for task in saying:
                    with contextlib.suppress(asyncio.CancelledError, *GONE):
                        await task
    except Busy as exc:
        await socket.close(TRY_AGAIN_LATER, str(exc))
    except Replaced:
        await socket.close(REPLACED, "a newer page with your token, or of somebody who drives, took this one's place")


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
