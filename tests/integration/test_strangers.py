"""Connections that never ask for anything are bounded in number, and keep nobody out."""

from __future__ import annotations

import asyncio
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import websockets

from shared.access import Role
from station.api import serving
from station.api.serving import MAX_STRANGERS
from tests.support.access import guarded_station
from tests.support.link import until
from tests.support.station import Desk, running_station

FLOOD = 3 * MAX_STRANGERS
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def flood(desk: Desk) -> list[Streams]:
    """Connections that say nothing."""
    address = urlsplit(desk.address)
    return [await asyncio.open_connection(address.hostname, address.port) for _ in range(FLOOD)]


async def ended(connections: list[Streams], at_least: int) -> None:
    """Wait until the station has ended so many of them."""
    await until(lambda: sum(reader.at_eof() or reader.exception() is not None for reader, _ in connections) >= at_least)


def leave(connections: list[Streams]) -> None:
    for _, writer in connections:
        writer.transport.abort()


async def test_handshakes_that_are_never_finished_keep_nobody_out(tmp_path: Path) -> None:
    async with guarded_station(tmp_path) as station:
        stuck = await flood(station.desk)
        try:
            await ended(stuck, FLOOD - MAX_STRANGERS)
            answer = await station.desk.http.get("/healthz", headers=station.headers(Role.WATCH))
            assert answer.status_code == 200
            async with station.socket("/ws/events", additional_headers=station.headers(Role.WATCH)) as socket:
                assert await socket.recv()
        finally:
            leave(stuck)


async def test_silent_connections_yield_to_others_and_those_in_use_stay(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk, websockets.connect(desk.socket("/ws/events")) as socket:
        assert await socket.recv()
        stuck = await flood(desk)
        try:
            await ended(stuck, FLOOD - MAX_STRANGERS)
            assert (await desk.http.get("/healthz")).status_code == 200
            assert await socket.recv()  # it asked for something long ago
        finally:
            leave(stuck)


async def test_a_connection_that_asks_for_nothing_is_ended_in_time_and_one_that_did_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serving, "FIRST_REQUEST_WITHIN_S", 0.5)
    async with running_station(1, tmp_path) as desk:
        address = urlsplit(desk.address)
        reader, writer = await asyncio.open_connection(address.hostname, address.port)
        trickling, trickler = await asyncio.open_connection(address.hostname, address.port)
        trickler.write(b"GET /robots HTTP/1.1\r\n")
        async with websockets.connect(desk.socket("/ws/events")) as socket:
            await ended([(reader, writer), (trickling, trickler)], 2)
            await socket.recv()
        leave([(reader, writer), (trickling, trickler)])
