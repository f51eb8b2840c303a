"""Runs a station and its API together, on a socket that is taken first."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Iterator
from typing import Any

import uvicorn
from fastapi import FastAPI

from shared.advice import complete, option
from shared.certificates import HANDSHAKE_WITHIN_S
from shared.ending import ending_signals
from shared.errors import ConfigError
from shared.listening import is_loopback
from shared.reception import Reception
from station.access.expiry import watch_expiry
from station.api.connections import KEY, STRANGER_WITHIN_S, Connection, Connections, HttpProtocol, SocketProtocol
from station.app import Station

logger = logging.getLogger(__name__)
PING_EVERY_S = PONG_WITHIN_S = 5.0  # a page whose network vanished gives its seat back within ten seconds
END_WITHIN_S = 2  # open video streams never end by themselves


class _Server(uvicorn.Server):
    """Signals are the caller's: the motors must stop first. Connections are bounded, so that nobody is kept out."""

    _watching: tuple[asyncio.Task[None], ...] = ()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Uvicorn's own, but for how connections are taken: it would take any number that never say a word."""
        assert sockets is not None and len(sockets) == 1
        await super().startup(sockets=[])
        tls: dict[str, Any] = {}
        if self.config.ssl is not None:
            tls = {"ssl": self.config.ssl, "ssl_handshake_timeout": HANDSHAKE_WITHIN_S}
        connections = Connections()
        reception = Reception(
            sockets[0],
            tls,
            connections.max_strangers,
            STRANGER_WITHIN_S,
            lambda caller: self._make_protocol(connections.open(caller)),
            callers_speak_first=True,
        )
        self._watching = (
            asyncio.create_task(reception.run(), name="API's reception"),
            asyncio.create_task(connections.watch(), name="API's connections"),
        )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for task in self._watching:
            task.cancel()
        await asyncio.gather(*self._watching, return_exceptions=True)
        await super().shutdown(sockets)

    def _make_protocol(self, connection: Connection) -> asyncio.Protocol:
        state = {**self.lifespan.state, KEY: connection}
        return HttpProtocol(config=self.config, server_state=self.server_state, app_state=state)


async def serve(
    station: Station, api: FastAPI, listener: socket.socket, started: Callable[[], None] = lambda: None
) -> None:
    """Run until cancelled. Raises ConfigError: the socket is open to others than the settings' host meant."""
    bound = str(listener.getsockname()[0])
    if station.access.door.is_open and not station.config.access.insecure and not is_loopback(bound):
        raise ConfigError(
            f"{station.config.api.host} means {bound} here, which others reach; give --host 127.0.0.1, or run"
            f" `station access init{option('--data', station.config.data_dir)}` and give --host 0.0.0.0"
        )
    identity = station.access.identity
    settings = uvicorn.Config(
        api,
        ssl_keyfile=None if identity is None else identity.key,
        ssl_certfile=None if identity is None else identity.certificate,
        log_config=None,  # its lines go where ours go, repeated ones once a minute
        log_level="warning",
        access_log=False,
        lifespan="off",
        timeout_graceful_shutdown=END_WITHIN_S,
        http=HttpProtocol,
        ws=SocketProtocol,
        ws_max_size=65536,  # pages only send small commands
        ws_ping_interval=PING_EVERY_S,
        ws_ping_timeout=PONG_WITHIN_S,
        ws_per_message_deflate=False,  # JPEG does not get smaller, and compressing costs the event loop
        server_header=False,
    )
    server = _Server(settings)
    opened = asyncio.Event()  # before it the last active map is not active yet
    running = asyncio.create_task(station.run(opened.set), name="station")
    serving = asyncio.create_task(server.serve(sockets=[listener]), name="API")
    data = {"--data": station.config.data_dir}
    watching = asyncio.create_task(
        watch_expiry(identity, lambda sentence: _warn(station, complete(sentence, "station", data))), name="certificate"
    )
    try:
        while not (server.started and opened.is_set()) and not serving.done() and not running.done():
            await asyncio.sleep(0.01)
        if not running.done():
            started()
        await asyncio.wait({running, serving}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        watching.cancel()
        station.stop()
        running.cancel()
        server.should_exit = True
        try:
            with contextlib.suppress(asyncio.CancelledError):
                await running
        finally:
            await serving


def _warn(station: Station, sentence: str) -> None:
    logger.warning("%s", sentence)
    station.events.notify("access", sentence, "warning")


async def serve_until_signal(
    station: Station, api: FastAPI, listener: socket.socket, started: Callable[[], None] = lambda: None
) -> None:
    """Run until SIGINT, SIGTERM or SIGHUP: a terminal that is closed."""
    loop = asyncio.get_running_loop()
    serving = asyncio.ensure_future(serve(station, api, listener, started))
    for number in ending_signals():
        loop.add_signal_handler(number, serving.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await serving
