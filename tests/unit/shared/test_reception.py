"""Reception: who is taken first, and who costs nothing."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from shared.listening import bind
from shared.reception import HANDSHAKES_AT_ONCE, Caller, Reception
from shared.seats import Rank, Seats

STRANGERS = 4 * HANDSHAKES_AT_ONCE
WITHIN_S = 30.0
OWNER, STRANGER = "127.0.0.2", "127.0.0.3"


class Spoken(asyncio.Protocol):
    """Knows the owner by the address, and notes from where connections come, in their order."""

    def __init__(self, caller: Caller, known: Seats, order: list[str]) -> None:
        self._caller, self._known, self._order = caller, known, order

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._caller.made(transport)
        host = transport.get_extra_info("peername")[0]
        self._order.append(host)
        if host == OWNER:
            assert self._caller.know(self._known, "owner", Rank.HIGH)

    def connection_lost(self, exc: Exception | None) -> None:
        self._caller.left()


@asynccontextmanager
async def received(
    listener: socket.socket, order: list[str], *, limit: int = 4 * STRANGERS, within_s: float = WITHIN_S
) -> AsyncIterator[None]:
    known = Seats(8, 8)
    reception = Reception(
        listener, {}, limit, within_s, lambda caller: Spoken(caller, known, order), callers_speak_first=True
    )
    running = asyncio.create_task(reception.run())
    try:
        yield
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


def call(listener: socket.socket, source: str) -> socket.socket:
    connection = socket.create_connection(listener.getsockname()[:2], source_address=(source, 0))
    connection.sendall(b"x")
    return connection


async def until_spoken(order: list[str], count: int) -> None:
    async with asyncio.timeout(WITHIN_S):
        while len(order) < count:
            await asyncio.sleep(0.01)


async def test_who_is_familiar_does_not_wait_for_a_crowd_of_strangers() -> None:
    order: list[str] = []
    async with received(listener := bind("127.0.0.1", 0), order):
        with call(listener, OWNER), contextlib.ExitStack() as crowd:
            await until_spoken(order, 1)
            for _ in range(STRANGERS):  # all of them are in the kernel's queue, the owner is the last
                crowd.enter_context(call(listener, STRANGER))
            with call(listener, OWNER):
                await until_spoken(order, STRANGERS + 2)
    assert OWNER in order[1 : 1 + HANDSHAKES_AT_ONCE]


async def until_ended(connection: socket.socket) -> None:
    connection.setblocking(False)
    async with asyncio.timeout(WITHIN_S):
        with contextlib.suppress(ConnectionResetError):
            assert await asyncio.get_running_loop().sock_recv(connection, 1) == b""


def is_open(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return bool(connection.recv(1))
    except BlockingIOError:
        return True
    except ConnectionResetError:
        return False


async def test_one_address_has_half_of_the_strangers_seats() -> None:
    order: list[str] = []
    async with received(listener := bind("127.0.0.1", 0), order, limit=8):
        with contextlib.ExitStack() as crowd:
            connections = [crowd.enter_context(call(listener, STRANGER)) for _ in range(8)]
            for connection in connections[:4]:
                await until_ended(connection)
            await until_spoken(order, 4)
            assert all(map(is_open, connections[4:]))


async def test_nobody_stays_a_stranger_for_long_and_who_is_known_stays() -> None:
    order: list[str] = []
    async with received(listener := bind("127.0.0.1", 0), order, within_s=0.2):
        with call(listener, OWNER) as owner, call(listener, STRANGER) as stranger:
            await until_ended(stranger)
            assert is_open(owner)


async def test_who_has_gone_without_a_word_is_not_received() -> None:
    order: list[str] = []
    listener = bind("127.0.0.1", 0)
    for _ in range(STRANGERS):
        socket.create_connection(listener.getsockname()[:2], source_address=(STRANGER, 0)).close()
    async with received(listener, order):
        with call(listener, OWNER):
            await until_spoken(order, 1)
    assert order == [OWNER]


@pytest.mark.parametrize("turns", range(6))
async def test_a_connection_that_comes_while_reception_ends_is_closed(turns: int) -> None:
    """However far it was taken in when the end came."""
    order: list[str] = []
    async with received(listener := bind("127.0.0.1", 0), order):
        await asyncio.sleep(0.05)  # it waits for callers
        caller = call(listener, STRANGER)
        for _ in range(turns):
            await asyncio.sleep(0)
    for _ in range(3):
        await asyncio.sleep(0.01)
    with caller:
        caller.settimeout(1.0)
        if not order:
            with contextlib.suppress(ConnectionResetError):
                assert caller.recv(1) == b""


@pytest.mark.skipif(sys.platform != "linux", reason="TCP_DEFER_ACCEPT is Linux's")
async def test_who_says_nothing_stays_with_the_kernel_until_he_speaks() -> None:
    order: list[str] = []
    async with received(listener := bind("127.0.0.1", 0), order):
        with socket.create_connection(listener.getsockname()[:2], source_address=(STRANGER, 0)) as silent:
            with call(listener, OWNER):
                await until_spoken(order, 1)
            assert order == [OWNER]
            silent.sendall(b"x")
            await until_spoken(order, 2)
    assert order == [OWNER, STRANGER]
