"""Opens the connection to a robot: plain on this machine, by TLS and only to a paired robot beyond it."""

from __future__ import annotations

import asyncio
import os
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass

from shared.access import Token
from shared.certificates import HANDSHAKE_WITHIN_S, fingerprint_of_der, pinning_context
from shared.errors import ConfigError, RobotSystemError
from station.paired_robots import PairedRobots

READ_BYTES = 256 * 1024
CONNECT_WITHIN_S = 1.5


class ConnectionRefused(RobotSystemError):
    """We do not talk to what answers there; the sentence says why. Trying again soon is of no use."""


@dataclass(frozen=True, slots=True)
class Connection:
    """An open connection to a robot."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    fingerprint: bytes = b""  # of its certificate; empty: no TLS
    token: Token | None = None  # what this station joins with


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


async def connect(host: str, port: int, robots: PairedRobots | None) -> Connection:
    """Raises OSError, UnicodeError (no host name), ConnectionRefused, ConfigError."""
    connection = await _open(host, port, lambda address: robots is not None and robots.needs_tls(host, port, address))
    if robots is None or not connection.fingerprint:
        return connection
    known = robots.recognise(connection.fingerprint, host, port)
    if isinstance(known, str):
        connection.writer.transport.abort()
        raise ConnectionRefused(known)
    return Connection(connection.reader, connection.writer, connection.fingerprint, known[1])


async def answers(host: str, port: int, robots: PairedRobots | None) -> bool:
    """Whether the robot says a first word on a new connection, which is closed again."""
    try:
        async with asyncio.timeout(CONNECT_WITHIN_S):
            connection = await connect(host, port, robots)
            try:
                return bool(await connection.reader.read(1))
            finally:
                connection.writer.transport.abort()
    except (OSError, ConnectionRefused, ConfigError):
        return False


async def connect_by_tls(host: str, port: int) -> Connection:
    """To whoever answers there; who it is is for the caller to find out. Raises OSError, ConnectionRefused."""
    return await _open(host, port, lambda _: True)


async def _open(host: str, port: int, needs_tls: Callable[[str], bool]) -> Connection:
    """Whether TLS is needed is asked of the very address that is connected to: a name may mean another one later."""
    loop = asyncio.get_running_loop()
    error: OSError | None = None
    for family, kind, protocol, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        connection = socket.socket(family, kind, protocol)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await loop.sock_connect(connection, address)
            if not needs_tls(str(address[0])):
                return Connection(*await asyncio.open_connection(sock=connection, limit=READ_BYTES))
            return await _shake_hands(connection, f"{host}:{port}")
        except OSError as exc:
            error = exc
            connection.close()
        except BaseException:
            connection.close()
            raise
    raise error or OSError("no address found")


async def _shake_hands(connection: socket.socket, name: str) -> Connection:
    try:
        reader, writer = await asyncio.open_connection(
            sock=connection,
            limit=READ_BYTES,
            ssl=pinning_context(),
            server_hostname="",
            ssl_handshake_timeout=HANDSHAKE_WITHIN_S,
        )
    except (ssl.SSLError, ConnectionResetError, ConnectionAbortedError) as exc:
        raise ConnectionRefused(
            f"{name} does not speak TLS ({exc}); robot-server there has no access control:"
            " run `robot-server access init` on the robot (docs/access.md)"
        ) from exc
    der = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    return Connection(reader, writer, fingerprint_of_der(der or b""))
