"""Connections that ask for nothing, and requests that never end, are bounded in number, size and time: nobody is kept
out by who has no token."""

from __future__ import annotations

import asyncio
import gc
import json
import logging
import resource
import ssl
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
import websockets
from typer.testing import CliRunner

from shared import reception
from shared.access import Role
from shared.reception import Caller
from station.access.visitors import access_folder
from station.api import connections, limits, serving
from station.api.connections import MAX_SENT_AHEAD, MAX_STRANGERS, Connection
from station.main import app as station_app
from tests.support.access import Guarded, guarded_station
from tests.support.link import WAIT_S, until
from tests.support.programs import program, said
from tests.support.station import Desk, running_station

FLOOD = 3 * MAX_STRANGERS
BEGIN_OF_TLS = b"\x16\x03\x01"
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def flood(desk: Desk, words: bytes) -> list[Streams]:
    """Connections that say this and no more."""
    address = urlsplit(desk.address)
    made = [await asyncio.open_connection(address.hostname, address.port) for _ in range(FLOOD)]
    for _, writer in made:
        writer.write(words)
    return made


async def ended(connections: list[Streams], at_least: int) -> None:
    """Wait until the station has ended so many of them."""
    await until(lambda: sum(reader.at_eof() or reader.exception() is not None for reader, _ in connections) >= at_least)


async def opened(station: Guarded, source: str = "127.0.0.1") -> Streams:
    """A connection by TLS from another address of this machine."""
    address = urlsplit(station.desk.address)
    return await asyncio.open_connection(
        address.hostname, address.port, ssl=station.context, local_addr=(source, 0), limit=1 << 20
    )


async def status_of(reader: asyncio.StreamReader) -> int:
    """Of the answer that comes next."""
    line = await asyncio.wait_for(reader.readline(), WAIT_S)
    return int(line.split()[1])


def head(path: str, length: int, *more: str) -> bytes:
    """Of a POST; its body may never come."""
    lines = [f"POST {path} HTTP/1.1", "Host: 127.0.0.1", "Content-Type: application/json", f"Content-Length: {length}"]
    return "\r\n".join([*lines, *more, "", ""]).encode()


async def write_for_ever(writer: asyncio.StreamWriter, data: bytes) -> None:
    """Raises ConnectionError: the station has ended it."""
    async with asyncio.timeout(3 * WAIT_S):
        while True:
            writer.write(data)
            await writer.drain()
            await asyncio.sleep(0.001)


async def pinged(socket: websockets.ClientConnection, count: int) -> None:
    """Each answered."""
    answers = [await socket.ping() for _ in range(count)]
    await answers[-1]


def leave(connections: list[Streams]) -> None:
    for _, writer in connections:
        writer.transport.abort()


async def test_handshakes_that_are_never_finished_keep_nobody_out(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        stuck = await flood(station.desk, BEGIN_OF_TLS)
        try:
            await ended(stuck, FLOOD - MAX_STRANGERS)
            answer = await station.desk.http.get("/healthz", headers=station.headers(Role.WATCH))
            assert answer.status_code == 200
            async with station.socket("/ws/events", additional_headers=station.headers(Role.WATCH)) as socket:
                assert await socket.recv()
        finally:
            leave(stuck)


def test_strangers_take_a_quarter_of_the_files_that_may_still_be_opened() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    left = connections.descriptors_left()
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft - left + 80, hard))
    try:
        assert 76 <= connections.descriptors_left() <= 80
        at_most = connections.Connections().max_strangers
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert at_most in (19, 20)


async def test_silent_connections_keep_nobody_out(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        stuck = await flood(station.desk, b"")
        try:
            answer = await station.desk.http.get("/healthz", headers=station.headers(Role.WATCH))
            assert answer.status_code == 200
        finally:
            leave(stuck)


async def test_of_handshakes_that_fail_nothing_is_kept(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        stuck = await flood(station.desk, b"no TLS begins so")
        await ended(stuck, FLOOD)
        leave(stuck)
        gc.collect()
        assert not [kept for kept in gc.get_objects() if isinstance(kept, Connection | Caller)]


async def test_connections_without_a_request_yield_to_others_and_those_in_use_stay(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk, websockets.connect(desk.socket("/ws/events")) as socket:
        assert await socket.recv()
        stuck = await flood(desk, b"GET")
        try:
            await ended(stuck, FLOOD - MAX_STRANGERS)
            assert (await desk.http.get("/healthz")).status_code == 200
            assert await socket.recv()  # it asked for something long ago
        finally:
            leave(stuck)


async def test_a_connection_that_asks_for_nothing_is_ended_in_time_and_one_that_did_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "HEAD_WITHIN_S", 0.5)
    monkeypatch.setattr(reception, "SILENT_S", 1)
    async with running_station(1, tmp_path) as desk:
        address = urlsplit(desk.address)
        reader, writer = await asyncio.open_connection(address.hostname, address.port)
        trickling, trickler = await asyncio.open_connection(address.hostname, address.port)
        trickler.write(b"GET /robots HTTP/1.1\r\n")
        async with websockets.connect(desk.socket("/ws/events")) as socket:
            await ended([(reader, writer), (trickling, trickler)], 2)
            await socket.recv()
        leave([(reader, writer), (trickling, trickler)])


async def test_a_connection_ends_with_a_refusal_and_goes_on_for_who_is_known(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station, asyncio.timeout(WAIT_S):
        stranger = await opened(station)
        stranger[1].write(2 * head("/stop", 0))
        assert (await stranger[0].read()).count(b"HTTP/1.1 401 ") == 1
        known = await opened(station)
        known[1].write(2 * head("/stop", 0, f"Authorization: Bearer {station.tokens[Role.ADMIN]}"))
        for _ in range(2):
            await known[0].readuntil(b"HTTP/1.1 503 ")
        leave([stranger, known])


async def test_a_few_requests_sent_ahead_of_the_answer_are_kept_and_no_more(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """250 kB of short ones from each of 40 strangers were 600 MB, and ten seconds in which nobody was heard."""
    async with guarded_station(tmp_path) as station:
        reader, writer = await opened(station)
        writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 5000)
        answers = await asyncio.wait_for(reader.read(-1), WAIT_S)
        writer.transport.abort()
    assert 1 <= answers.count(b"HTTP/1.1 200 OK") <= 1 + MAX_SENT_AHEAD
    assert answers.count(b"HTTP/1.1 ") == answers.count(b"HTTP/1.1 200 OK"), "no other answer in the midst of one"
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]


async def test_refused_sockets_leave_no_line_in_the_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async with guarded_station(tmp_path) as station:
        for path in ("/ws/events", "/ws/drive", "/ws/nothing"):
            with pytest.raises(websockets.InvalidStatus, match="401"):
                async with station.socket(path):
                    pass
    assert logging.getLogger("uvicorn.error").propagate  # else nothing of it would be seen here
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING] == []


@pytest.mark.parametrize("pieces", [b"\xff\xfe", (b'{"type": "st', b'op\xff"}')], ids=["whole", "in pieces"])
async def test_a_socket_that_says_no_text_is_closed_with_one_line_in_the_log(
    tmp_path: Path, pieces: bytes | tuple[bytes, ...], caplog: pytest.LogCaptureFixture
) -> None:
    async with guarded_station(tmp_path) as station, asyncio.timeout(3 * WAIT_S):
        async with station.socket("/ws/drive", additional_headers=station.headers(Role.DRIVE)) as socket:
            await socket.send(pieces, text=True)
            await socket.wait_closed()
            assert socket.close_code == 1007
        async with station.socket("/ws/drive", additional_headers=station.headers(Role.DRIVE)) as socket:
            await socket.send('{"type": "stop", "reason": "ä"}')
            assert await socket.recv()
    (line,) = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert "no UTF-8" in line.getMessage() and line.exc_info is None


async def test_a_socket_that_floods_is_ended_and_one_that_says_what_waited_is_not(tmp_path: Path) -> None:
    """Of a watcher's 2 MB of the shortest frames the station heard nobody else for four seconds."""
    async with guarded_station(tmp_path) as station, asyncio.timeout(3 * WAIT_S):
        lively = json.dumps({"type": "drive", "seq": 1, "linear": 0.1, "angular": 0.0, "ttl_ms": 250, "heard_ms": 0})
        async with station.socket("/ws/drive", additional_headers=station.headers(Role.DRIVE)) as socket:
            for _ in range(16 * 20):
                await socket.send(lively)
            await asyncio.wait_for(await socket.ping(), WAIT_S)
        async with station.socket("/ws/events", additional_headers=station.headers(Role.WATCH)) as socket:
            with pytest.raises(websockets.ConnectionClosed):
                await pinged(socket, 30_000)


@pytest.mark.parametrize("path", ["/maps", "/stop", "/drive", "/nothing"])
async def test_who_has_no_token_is_refused_before_the_body_is_read(tmp_path: Path, path: str) -> None:
    async with guarded_station(tmp_path) as station:
        reader, writer = await opened(station)
        writer.write(head(path, 1_000_000))
        assert await status_of(reader) == 401
        leave([(reader, writer)])


@pytest.mark.parametrize(
    "foreign", ["Origin: https://evil.example", "Host: evil.example", "Sec-Fetch-Site: cross-site"]
)
async def test_pages_of_others_are_refused_before_the_body_is_read(tmp_path: Path, foreign: str) -> None:
    async with guarded_station(tmp_path) as station:
        reader, writer = await opened(station)
        token = f"Authorization: Bearer {station.tokens[Role.ADMIN]}"
        writer.write(head("/maps", 60_000, token, foreign).replace(b"Host: 127.0.0.1\r\n", b"", "Host" in foreign))
        assert await status_of(reader) == 403
        leave([(reader, writer)])


async def test_a_login_may_be_no_larger_and_take_no_longer_than_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "STRANGERS_BODY", limits.BodyBounds(4096, 0.3))
    async with guarded_station(tmp_path) as station:
        for length, status in {4097: 413, 4000: 408}.items():
            reader, writer = await opened(station)
            writer.write(head("/login", length))
            assert await status_of(reader) == status
            leave([(reader, writer)])


async def test_a_body_that_never_ends_is_ended_also_of_somebody_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "KNOWN_BODY", limits.BodyBounds(limits.MAX_BODY_BYTES, 0.3))
    async with guarded_station(tmp_path) as station:
        reader, writer = await opened(station)
        writer.write(head("/maps", 60_000, f"Authorization: Bearer {station.tokens[Role.ADMIN]}") + bytes(1000))
        assert await status_of(reader) == 408
        leave([(reader, writer)])


async def test_a_head_that_never_ends_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "HEAD_WITHIN_S", 600.0)  # for its size, not for its time
    async with guarded_station(tmp_path) as station:
        reader, writer = await opened(station)
        writer.write(b"GET /robots HTTP/1.1\r\n")
        with pytest.raises(ConnectionError):
            await write_for_ever(writer, b"X: " + b"x" * 1000 + b"\r\n")
        leave([(reader, writer)])


async def test_an_answer_that_nobody_takes_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "TAKEN_WITHIN_S", 0.5)
    async with guarded_station(tmp_path) as station:
        reader, writer = await opened(station)
        writer.transport.pause_reading()
        token = f"Authorization: Bearer {station.tokens[Role.WATCH]}"
        ask = f"GET /openapi.json HTTP/1.1\r\nHost: 127.0.0.1\r\n{token}\r\n\r\n"
        with pytest.raises(ConnectionError):
            await write_for_ever(writer, ask.encode())
        leave([(reader, writer)])


async def test_an_address_where_nobody_is_known_keeps_no_other_out(tmp_path: Path) -> None:
    """A right token was shown from 127.0.0.1; then 127.0.0.2 to .9 flood."""
    async with guarded_station(tmp_path) as station:
        admin = station.headers(Role.ADMIN)
        assert (await station.desk.http.get("/healthz", headers=admin)).status_code == 200
        known = await opened(station)  # it has not shown anything yet
        strangers = [await opened(station, f"127.0.0.{2 + n % 8}") for n in range(FLOOD)]
        try:
            await ended(strangers, FLOOD - MAX_STRANGERS)
            reader, writer = known
            writer.write(head("/stop", 0, f"Authorization: Bearer {station.tokens[Role.ADMIN]}"))
            assert await status_of(reader) == 503  # there is no robot
        finally:
            leave([known, *strangers])


async def test_however_long_bodies_may_take_strangers_hold_no_more_of_them_than_they_have_seats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By their time they would all end in the end, and whoever waits long enough gets in without seats, too."""
    monkeypatch.setattr(limits, "STRANGERS_BODY", limits.BodyBounds(4096, 600.0))
    monkeypatch.setattr(serving, "STRANGER_WITHIN_S", 600.0)
    async with guarded_station(tmp_path) as station:
        strangers = [await opened(station, f"127.0.0.{2 + n % 8}") for n in range(2 * MAX_STRANGERS)]
        try:
            for _, writer in strangers:
                writer.write(head("/login", 4000) + bytes(100))
            await ended(strangers, MAX_STRANGERS)
            answer = await station.desk.http.post("/stop", headers=station.headers(Role.ADMIN))
            assert answer.json()["type"] == "/problems/no-robot"
        finally:
            leave(strangers)


async def test_stop_is_answered_while_strangers_hold_more_bodies_open_than_there_are_descriptors(
    tmp_path: Path,
) -> None:
    made = CliRunner().invoke(station_app, ["access", "init", "--data", str(tmp_path), "--json"])
    admin = {"Authorization": f"Bearer {json.loads(made.stdout)['token']}"}
    config = tmp_path / "station.toml"
    config.write_text("[access]\non_loopback = true\n")
    words = ("serve", "--robot", "127.0.0.1:1", "--port", "0", "--data", str(tmp_path), "--config", str(config))
    async with program("station.main", *words, descriptors=256) as process:
        address = (await said(process, r"(https://\S+)"))[1]
        context = ssl.create_default_context(cafile=str(access_folder(tmp_path) / "certificate.pem"))
        at = urlsplit(address)
        strangers: list[Streams] = []
        try:
            for _ in range(300):
                streams = await asyncio.open_connection(at.hostname, at.port, ssl=context)
                streams[1].write(head("/login", 4000) + bytes(100))
                strangers.append(streams)
            async with httpx.AsyncClient(base_url=address, verify=context, timeout=WAIT_S) as http:
                answer = await http.post("/stop", headers=admin)
                assert answer.json()["type"] == "/problems/no-robot"
        finally:
            leave(strangers)
