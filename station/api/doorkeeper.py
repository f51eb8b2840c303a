"""ASGI middleware: finds out who asks from where, and ends what is open when a token is revoked.

What is refused here is refused before anything of a body is read. `deps.admit` says what a role may.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Literal

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from shared.errors import RobotSystemError
from station.access.visitors import EVERYBODY, Visitor
from station.api.connections import KEY, Connection
from station.api.problems import answer_to
from station.api.roles import is_open
from station.api.sites import check_site
from station.app import Station
from station.errors import NotAllowed, TooManyGuesses, WrongToken

COOKIE = "__Host-sentinel-session"  # browsers keep such a name for HTTPS, for this host alone
REVOKED = 4401  # close code
LOGOUT = "/logout"
MAX_SHOWN = 256
Found = Visitor | WrongToken | TooManyGuesses


# Other sites' pages may show nothing of ours, nor take it for a script.
FOR_US_ALONE = {"Cross-Origin-Resource-Policy": "same-origin", "X-Content-Type-Options": "nosniff"}


class Doorkeeper:
    """Puts the visitor, or why there is none, into the scope's state as `visitor`."""

    def __init__(self, app: ASGIApp, station: Station) -> None:
        self._app = app
        self._station = station
        self._door = station.access.door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        connection: Connection | None = scope.setdefault("state", {}).get(KEY)
        with contextlib.nullcontext() if connection is None else connection.serving():
            await self._receive(HTTPConnection(scope), connection, receive, _labelled(send))

    async def _receive(
        self, asked: HTTPConnection, connection: Connection | None, receive: Receive, send: Send
    ) -> None:
        try:
            check_site(asked, self._station.config.api, speaks_tls=self._station.access.identity is not None)
            visitor = asked.scope["state"]["visitor"] = self._identify(asked)
            _check_visitor(asked, visitor)
            if isinstance(visitor, Visitor) and connection is not None:
                connection.recognise(visitor)
        except RobotSystemError as exc:
            await answer_to(asked, exc)(asked.scope, receive, _last(send))
            return
        # Who logs out ends what they came with: the answer goes out all the same.
        if isinstance(visitor, Visitor) and visitor.token_id and asked.scope["path"] != LOGOUT:
            await self._serve(visitor, asked, connection, receive, send)
        else:
            await self._app(asked.scope, receive, send)

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

    async def _serve(
        self, visitor: Visitor, asked: HTTPConnection, connection: Connection | None, receive: Receive, send: Send
    ) -> None:
        """Serve it in a task of its own, which is ended when the token is revoked."""
        sent: list[str] = []

        async def noting(message: Message) -> None:
            await send(message)
            sent.append(message["type"])

        serving = asyncio.ensure_future(self._app(asked.scope, receive, noting))
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
            await _say_goodbye(asked, sent, receive, send)
            if connection is not None and "http.response.start" in sent:
                # The answer's head promised that the connection stays; who waits for its end would wait for that.
                connection.end()


def _check_visitor(asked: HTTPConnection, visitor: Found) -> None:
    """Raises WrongToken, TooManyGuesses, NotAllowed."""
    method = asked.scope.get("method", "WS")
    if is_open(method, asked.scope["path"]):
        return
    if not isinstance(visitor, Visitor):
        raise visitor
    if visitor.by == "cookie" and method != "GET" and "origin" not in asked.headers:
        raise NotAllowed("a browser says which page asks (`Origin`); programs send `Authorization: Bearer` instead")


def _labelled(send: Send) -> Send:
    async def labelling(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(FOR_US_ALONE)
        await send(message)

    return labelling


def _last(send: Send) -> Send:
    """The connection ends with this answer: who is refused may not ask on and on, which is cheap for them alone."""

    async def ending(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message)["Connection"] = "close"
        await send(message)

    return ending


async def _say_goodbye(asked: HTTPConnection, sent: list[str], receive: Receive, send: Send) -> None:
    why = "your token was revoked"
    with contextlib.suppress(Exception):  # the peer may be gone, or have got less than it was promised
        if asked.scope["type"] == "websocket":
            if "websocket.close" not in sent:
                await send({"type": "websocket.close", "code": REVOKED, "reason": why})
        elif "http.response.start" in sent:
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        else:
            await answer_to(asked, WrongToken(why))(asked.scope, receive, _last(send))


def shown_by(connection: HTTPConnection) -> tuple[Literal["bearer", "cookie"], str]:
    """What a caller shows, cut to a length that is looked at. Never in the address, which ends up in logs."""
    scheme, _, token = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token.strip():
        return "bearer", token.strip()[:MAX_SHOWN]
    return "cookie", connection.cookies.get(COOKIE, "")[:MAX_SHOWN]


def address_of(connection: HTTPConnection) -> str:
    """Whom to count wrong tokens against."""
    return connection.client.host if connection.client else "?"
