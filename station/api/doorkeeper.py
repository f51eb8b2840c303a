"""ASGI middleware: finds out who asks, and ends what is open when a token is revoked. `deps.admit` says who may."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Literal

from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from station.access.visitors import EVERYBODY, Door, Visitor
from station.errors import TooManyGuesses, WrongToken

COOKIE = "__Host-sentinel-session"  # browsers keep such a name for HTTPS, for this host alone
REVOKED = 4401  # close code
MAX_SHOWN = 256
Found = Visitor | WrongToken | TooManyGuesses


class Doorkeeper:
    """Puts the visitor, or why there is none, into the scope's state as `visitor`."""

    def __init__(self, app: ASGIApp, door: Door) -> None:
        self._app = app
        self._door = door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        visitor = self._identify(HTTPConnection(scope))
        scope.setdefault("state", {})["visitor"] = visitor
        if isinstance(visitor, Visitor) and visitor.token_id:
            await self._serve(visitor, scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _identify(self, connection: HTTPConnection) -> Found:
        if self._door.is_open:
            return EVERYBODY
        by, shown = shown_by(connection)
        try:
            return (
                self._door.admit(shown, by, address_of(connection))
                if shown
                else WrongToken(
                    "this station asks who you are: send `Authorization: Bearer TOKEN`, or log in on the page"
                )
            )
        except (WrongToken, TooManyGuesses) as exc:
            return exc

    async def _serve(self, visitor: Visitor, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve it in a task of its own, which is ended when the token is revoked."""
        sent: list[str] = []

        async def noting(message: Message) -> None:
            await send(message)
            sent.append(message["type"])

        serving = asyncio.ensure_future(self._app(scope, receive, noting))
        revoked = asyncio.Event()

        def end() -> None:
            revoked.set()
            serving.cancel()

        with self._door.visit(visitor, end):
            try:
                await serving
            except asyncio.CancelledError:
                if not revoked.is_set():
                    serving.cancel()
                    with contextlib.suppress(asyncio.CancelledError):
                        await serving
                    raise
        if revoked.is_set():
            await _say_goodbye(scope, sent, send)


async def _say_goodbye(scope: Scope, sent: list[str], send: Send) -> None:
    with contextlib.suppress(Exception):  # the peer may be gone, or have got less than it was promised
        if scope["type"] == "websocket" and "websocket.close" not in sent:
            await send({"type": "websocket.close", "code": REVOKED, "reason": "your token was revoked"})
        elif "http.response.start" in sent:
            await send({"type": "http.response.body", "body": b"", "more_body": False})


def shown_by(connection: HTTPConnection) -> tuple[Literal["bearer", "cookie"], str]:
    """What a caller shows, cut to a length that is looked at. Never in the address, which ends up in logs."""
    scheme, _, token = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token.strip():
        return "bearer", token.strip()[:MAX_SHOWN]
    return "cookie", connection.cookies.get(COOKIE, "")[:MAX_SHOWN]


def address_of(connection: HTTPConnection) -> str:
    """Whom to count wrong tokens against."""
    return connection.client.host if connection.client else "?"
