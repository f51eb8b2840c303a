"""Opening a connection to a robot, and leaving it."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Any

import psutil
import pytest

from shared.certificates import make_identity
from station.access.connecting import connect_by_tls
from tests.support.access import NOW
from tests.support.link import until


async def test_an_attempt_given_up_as_its_handshake_ends_is_closed_and_harms_no_other_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both happen in one turn of an event loop that was held up: the answer came, and it is too late."""

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        number = len(ended)
        ended.append(False)
        with contextlib.suppress(OSError):
            await reader.read()
        writer.transport.abort()
        ended[number] = True

    said: list[dict[str, Any]] = []
    ended: list[bool] = []  # on the robot's side
    asyncio.get_running_loop().set_exception_handler(lambda _, context: said.append(context))
    context = make_identity(tmp_path, "test", ["127.0.0.1"], 10, NOW).server_context()
    server = await asyncio.start_server(silent, "127.0.0.1", 0, ssl=context)
    port = server.sockets[0].getsockname()[1]
    first = await connect_by_tls("127.0.0.1", port)  # the thread for names is there from now on
    first.writer.transport.abort()
    original = asyncio.StreamReaderProtocol.connection_made

    def made(self: asyncio.StreamReaderProtocol, transport: asyncio.BaseTransport) -> None:
        original(self, transport)
        if transport.get_extra_info("peername")[1] == port:
            attempt.cancel()

    process = psutil.Process()
    await until(lambda: ended == [True])
    before = process.num_fds()
    with monkeypatch.context() as patched:
        patched.setattr(asyncio.StreamReaderProtocol, "connection_made", made)
        attempt = asyncio.create_task(connect_by_tls("127.0.0.1", port))
        await asyncio.wait([attempt])
    assert attempt.cancelled()
    for _ in range(3):  # they get the numbers of sockets that were closed
        other = await connect_by_tls("127.0.0.1", port)
        other.writer.transport.abort()
    await until(lambda: len(ended) == 5 and all(ended))
    await until(lambda: process.num_fds() <= before)
    assert not said
    server.close()


async def test_a_connection_that_was_cut_still_knows_whose_it_was(tmp_path: Path) -> None:
    """Asked for the link's state between the cut and its being noticed: by TLS asyncio has forgotten the peer then."""

    async def cut(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    context = make_identity(tmp_path, "test", ["127.0.0.1"], 10, NOW).server_context()
    server = await asyncio.start_server(cut, "127.0.0.1", 0, ssl=context)
    connection = await connect_by_tls("127.0.0.1", server.sockets[0].getsockname()[1])
    with contextlib.suppress(OSError):
        await connection.reader.read()
    await until(lambda: connection.writer.get_extra_info("peername") is None)
    assert connection.is_loopback
    server.close()
