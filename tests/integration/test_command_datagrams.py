"""Commands by datagram over real sockets: they move and stop motors by themselves, and none does that may not."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import pytest

from robot.commands import notice
from shared.access import Role
from shared.messages import Drive, StationMessage, Stop
from shared.session import Event
from station.access import connecting
from station.robots.datagrams import PictureDatagrams
from station.robots.link import RobotLink
from station.robots.link_commands import DueMessages
from tests.support.link import Bench, linked, running_robot, until


@pytest.fixture(autouse=True)
def beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """As over a network, whose connection stands still for commands."""
    put = DueMessages.put

    def put_others(due: DueMessages, message: StationMessage) -> None:
        if not isinstance(message, Drive | Stop):
            put(due, message)

    monkeypatch.setattr(DueMessages, "put", put_others)
    monkeypatch.setattr(connecting, "is_loopback", lambda _: False)


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Every datagram with a command, as the station sends it."""
    heard: list[bytes] = []
    handle = PictureDatagrams._send

    def note(self: PictureDatagrams, message: Drive | Stop) -> None:
        sealer = self._sealer
        if sealer is not None and isinstance(message, Drive | Stop):
            seal = sealer.seal
            with monkeypatch.context() as patched:
                patched.setattr(sealer, "seal", lambda content: heard.append(seal(content)) or heard[-1])
                handle(self, message)
        else:
            handle(self, message)

    monkeypatch.setattr(PictureDatagrams, "_send", note)
    return heard


async def drive_until(bench: Bench, link: RobotLink, condition: Callable[[], object]) -> None:
    async def hold() -> None:
        while True:
            link.commands.drive(0.1, 0.0, 200)
            await asyncio.sleep(0.02)

    holding = asyncio.create_task(hold())
    try:
        await until(condition)
    finally:
        holding.cancel()


async def test_datagrams_alone_drive_and_stop_and_old_ones_do_nothing(said: list[bytes]) -> None:
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link._datagrams is not None and link._datagrams._sealer is not None)
        await drive_until(bench, link, lambda: any(speed for _, speed, _ in bench.motors.history))
        assert not bench.motors.are_off
        link.commands.stop()
        await until(lambda: bench.motors.are_off)
        num, client = len(bench.motors.history), next(iter(bench.server._clients.values()))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
            thief.bind(("127.0.0.1", 0))
            assert client.datagrams is not None
            before = client.datagrams.path._opener.refused
            stolen = list(said)  # the stop is still to be said again
            for datagram in stolen:
                thief.sendto(datagram, ("127.0.0.1", bench.port))
            path = client.datagrams.path
            await until(lambda: path._opener.refused >= before + len(stolen))
        assert not any(speed for _, speed, _ in bench.motors.history[num:])


async def test_a_station_that_may_only_watch_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[object] = []
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link._datagrams is not None and link._datagrams._sealer is not None)
        client = next(iter(bench.server._clients.values()))
        client.role = Role.WATCH
        assert client.datagrams is not None
        told = client.datagrams._on_message
        monkeypatch.setattr(
            client.datagrams, "_on_message", lambda message, t_ns: (told(message, t_ns), heard.append(message))
        )
        await drive_until(bench, link, lambda: sum(isinstance(m, Drive) for m in heard) > 10)
        assert not any(speed for _, speed, _ in bench.motors.history)


async def test_datagrams_of_a_session_that_has_ended_move_nothing() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link._datagrams is not None and link._datagrams._sealer is not None)
        client = next(iter(bench.server._clients.values()))
        await drive_until(bench, link, lambda: not bench.motors.are_off)
        assert client.datagrams is not None
        on_message = client.datagrams._on_message
        client.end(Event.LOST, notice("shutdown", "revoked", fatal=True))
        await until(lambda: bench.motors.are_off)
        num = len(bench.motors.history)
        now_ns = bench.clock()
        for seq in range(1000, 1010):
            on_message(Drive(seq=seq, t_station_ns=now_ns, linear=0.1, angular=0.0, ttl_ms=200), now_ns)
        await until(lambda: client.id not in bench.server._clients)
        assert not any(speed for _, speed, _ in bench.motors.history[num:])
