"""Opens the connection to a robot: plain on this machine, by TLS and only to a paired robot beyond it."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

from shared.access import Token
from shared.certificates import HANDSHAKE_WITHIN_S, fingerprint_of_der, pinning_context
from shared.errors import ConfigError, RobotSystemError
from shared.listening import is_loopback, show_address
from shared.prompt_sending import UNSENT_COMMAND_BYTES, send_promptly
from station.access.paired_robots import PairedRobots

logger = logging.getLogger(__name__)

READ_BYTES = 256 * 1024
CONNECT_WITHIN_S = 1.5
# Whether a robot is still paired. It is left after two looks that do not find it, since a file may be away for a moment
# while somebody puts back an older one; within a second of its being forgotten, with a fifth of it left for the looks.
LOOK_EVERY_S = 0.4
LOOKS = 2


class ConnectionRefused(RobotSystemError):
    """We do not talk to what answers there; the sentence says why. Trying again soon is of no use."""


@dataclass(frozen=True, slots=True)
class Connection:
    """An open connection to a robot."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    peer: tuple[Any, ...]  # address and port, as sockets have them; asyncio forgets them when TLS ends
    fingerprint: bytes = b""  # of its certificate; empty: no TLS
    token: Token | None = None  # what this station joins with
    heard: bytes = b""  # what the robot has said already

    @property
    def is_loopback(self) -> bool:
        """Whether the robot's program runs on this machine."""
        return is_loopback(str(self.peer[0]))


def in_words(error: BaseException, address: str) -> str:
    """What an error of the network means, for a person: the system's own text names numbers and calls."""
    match error:
        case ConnectionRefusedError():
            return f"nothing answers at {address}"
        case socket.gaierror():
            return f"{address.rpartition(':')[0]} is no name that this network knows"
        case ConnectionResetError() | BrokenPipeError() | ConnectionAbortedError():
            return f"{address} closed the connection"
        case TimeoutError():
            return f"no answer from {address}"
        case OSError(errno=int(number)) if number > 0:
            return f"{address} cannot be reached ({os.strerror(number).lower()})"
    return f"{address} cannot be reached ({error})"


async def connect(host: str, port: int, robots: PairedRobots | None, *, is_given: bool = True) -> Connection:
    """To the robot that this address means, or (not `is_given`: it was found) to any paired one.

    Raises OSError, UnicodeError (no host name), ConnectionRefused, ConfigError.
    """
    connection = await _open(host, port, lambda address: robots is not None and robots.needs_tls(host, port, address))
    if robots is None or not connection.fingerprint:
        return connection
    recognise = robots.recognise if is_given else robots.recognise_anywhere
    try:
        known = await asyncio.to_thread(recognise, connection.fingerprint, host, port)  # it may write
        if isinstance(known, str):
            raise ConnectionRefused(known)
    except BaseException:
        connection.writer.transport.abort()
        raise
    return replace(connection, token=known[1])


async def connect_and_hear(
    host: str, port: int, robots: PairedRobots | None, *, is_given: bool = True
) -> Connection | None:
    """A connection on which the robot has said a first word; None where none is to be had."""
    try:
        async with asyncio.timeout(CONNECT_WITHIN_S):
            connection = await connect(host, port, robots, is_given=is_given)
            try:
                heard = await connection.reader.read(READ_BYTES)
            except BaseException:
                connection.writer.transport.abort()
                raise
    except (OSError, ConnectionRefused, ConfigError):
        return None
    if not heard:
        connection.writer.transport.abort()
        return None
    return replace(connection, heard=heard)


async def until_forgotten(fingerprint: bytes, robots: PairedRobots) -> str:
    """Wait until the robot with this certificate is paired no longer, and say so."""
    missed, damage = 0, ""
    while missed < LOOKS:
        await asyncio.sleep(LOOK_EVERY_S)
        try:
            missed = 0 if await asyncio.to_thread(robots.knows, fingerprint) else missed + 1
            damage = ""
        except ConfigError as exc:  # who was let in stays
            if str(exc) != damage:
                damage = str(exc)
                logger.warning("whether the robot is still paired cannot be looked up: %s", damage)
    return "its certificate is not paired with this station any more"


async def connect_by_tls(host: str, port: int) -> Connection:
    """To whoever answers there; who it is is for the caller to find out. Raises OSError, ConnectionRefused."""
    return await _open(host, port, lambda _: True)


async def _open(host: str, port: int, needs_tls: Callable[[str], bool]) -> Connection:
    """Whether TLS is needed is asked of the very address that is connected to: a name may mean another one later."""
    loop = asyncio.get_running_loop()
    error: OSError | None = None
    for family, kind, protocol, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        by_tls = needs_tls(str(address[0]))  # before there is a socket to be left open by what it raises
        connection = socket.socket(family, kind, protocol)
        try:
            connection.setblocking(False)
            send_promptly(connection, UNSENT_COMMAND_BYTES)
            await loop.sock_connect(connection, address)
        except OSError as exc:
            error = exc
            connection.close()
            continue
        except BaseException:
            connection.close()
            raise
        try:
            if by_tls:
                return await _shake_hands(connection, show_address(host, port), address)
            return Connection(*await _streams(connection), address)
        except OSError as exc:
            error = exc
    raise error or OSError("no address found")


class _Leavable(asyncio.StreamReaderProtocol):
    """A connection that can be left at any step of its making; asyncio would first say goodbye to its peer, by TLS."""

    _made: asyncio.Transport | None = None
    _is_left = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._made = cast(asyncio.Transport, transport)
        if self._is_left:
            self._made.abort()
        else:
            super().connection_made(transport)

    def leave(self) -> None:
        self._is_left = True
        if self._made is not None:
            self._made.abort()


async def _streams(connection: socket.socket, **tls: Any) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """`tls`: as for loop.create_connection.

    The socket is the transport's from here on, whatever happens: closed under it, its number would be another
    connection's while the event loop still takes it for this one.
    """
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader(limit=READ_BYTES, loop=loop)
    protocol = _Leavable(reader, loop=loop)
    try:
        transport, _ = await loop.create_connection(lambda: protocol, sock=connection, **tls)
    except BaseException:
        protocol.leave()
        raise
    return reader, asyncio.StreamWriter(transport, protocol, reader, loop)


async def _shake_hands(connection: socket.socket, name: str, peer: tuple[Any, ...]) -> Connection:
    try:
        reader, writer = await _streams(
            connection, ssl=pinning_context(), server_hostname="", ssl_handshake_timeout=HANDSHAKE_WITHIN_S
        )
    except ConnectionAbortedError as exc:  # by ourselves: asyncio's word for a handshake that took too long
        raise TimeoutError(str(exc)) from exc
    except ConnectionResetError as exc:  # it may speak TLS as well as any: one without says its hello at once
        raise ConnectionRefused(
            f"{name} ended the connection before it said who it is: robot-server there is just ending or starting, or"
            " too many others call it"
        ) from exc
    except ssl.SSLError as exc:
        remedy = "run `robot-server access init` on the robot"
        if is_loopback(str(peer[0])):
            remedy = "on loopback it needs no pairing, or `[access] folder` in its TOML file"
        raise ConnectionRefused(
            f"{name} does not speak TLS ({exc}); robot-server there has no access control: {remedy} (docs/access.md)"
        ) from exc
    der = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    return Connection(reader, writer, peer, fingerprint_of_der(der or b""))
