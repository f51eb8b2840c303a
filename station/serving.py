"""Runs a station and its API together, on a socket that is taken first."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import socket
from collections.abc import Callable, Iterator

import uvicorn

from shared.errors import ConfigError
from shared.listening import is_loopback
from station.api.server import make_api
from station.app import Station
from station.expiry import watch_expiry

logger = logging.getLogger(__name__)
PING_EVERY_S = PONG_WITHIN_S = 5.0  # a page whose network vanished gives its seat back within ten seconds
END_WITHIN_S = 2  # open video streams never end by themselves


class _Server(uvicorn.Server):
    """Signals are the caller's: the motors must stop first."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def serve(station: Station, listener: socket.socket, started: Callable[[], None] = lambda: None) -> None:
    """Run until cancelled. Raises ConfigError: the socket is open to others than the settings' host meant."""
    bound = str(listener.getsockname()[0])
    if station.access.door.is_open and not station.config.access.insecure and not is_loopback(bound):
        raise ConfigError(
            f"{station.config.api.host} means {bound} here, which others reach; give --host 127.0.0.1, or run"
            " `station access init` and give --host 0.0.0.0"
        )
    api = make_api(station)
    identity = station.access.identity
    settings = uvicorn.Config(
        api,
        ssl_keyfile=None if identity is None else identity.key,
        ssl_certfile=None if identity is None else identity.certificate,
        log_level="warning",
        access_log=False,
        lifespan="off",
        timeout_graceful_shutdown=END_WITHIN_S,
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
    watching = asyncio.create_task(
        watch_expiry(identity, lambda sentence: _warn(station, sentence)), name="certificate"
    )  # fmt: skip
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
    station.events.say("access", sentence, "warning")


async def serve_until_signal(
    station: Station, listener: socket.socket, started: Callable[[], None] = lambda: None
) -> None:
    """Run until SIGINT or SIGTERM."""
    loop = asyncio.get_running_loop()
    serving = asyncio.ensure_future(serve(station, listener, started))
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, serving.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await serving
