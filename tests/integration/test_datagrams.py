"""Pictures by datagrams over real sockets: the same pictures, TCP again where none arrive, strangers change nothing."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from robot.commands import notice
from robot.datagram_port import DatagramPort
from robot.datagram_sender import DatagramSender
from robot.station_client import StationClient
from shared.datagrams import HEADER
from shared.session import Event
from station.access import connecting
from station.robots.datagrams import PictureDatagrams
from station.robots.link import RobotLink
from tests.support.link import Bench, Notes, linked, running_robot, until


@asynccontextmanager
async def thin_link(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[tuple[Bench, RobotLink, Notes, StationClient]]:
    """A link of this machine that is asked to be taken for a thin one of a network."""
    monkeypatch.setattr(connecting, "is_loopback", lambda _: False)
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        client = next(iter(bench.server._clients.values()))
        assert client.video is not None
        client.video.is_thin = True
        yield bench, link, notes, client


def sender_of(client: StationClient) -> DatagramSender:
    assert client.datagrams is not None
    return client.datagrams


async def show(bench: Bench, notes: Notes, count: int) -> None:
    """Take pictures until so many more have arrived."""
    wanted, number = len(notes.frames) + count, bench.server._frames.count
    while len(notes.frames) < wanted:
        bench.camera.put(t_robot_ns=number, size=1000 + 500 * (number % 20))
        number += 1
        await asyncio.sleep(0.01)


def check(notes: Notes) -> None:
    """Each is as the camera gave it, and none behind a newer one."""
    for frame, _ in notes.frames:
        assert len(frame.jpeg) == 1000 + 500 * (frame.seq % 20) and frame.t_robot_ns == frame.seq
    seqs = [frame.seq for frame, _ in notes.frames]
    assert seqs == sorted(set(seqs))


async def test_pictures_by_datagrams_are_those_of_the_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    async with thin_link(monkeypatch) as (bench, link, notes, client):
        await until(lambda: client.datagrams is not None and client.datagrams.is_used)
        begun = len(notes.frames)
        await show(bench, notes, 30)
        check(notes)
        assert link._datagrams is not None and link._datagrams.num_datagrams > 30
        assert link.state.frames == len(notes.frames) and begun == 0
        bench.imu.inject(100)
        await until(lambda: len(notes.sequences) == 100)


async def test_pictures_come_by_tcp_again_when_no_datagram_arrives_and_by_datagrams_when_they_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arrives = True
    send = DatagramPort._send

    def send_or_lose(port: DatagramPort, datagram: bytes, address: tuple[str | int, ...]) -> None:
        if arrives:
            send(port, datagram, address)

    monkeypatch.setattr(DatagramPort, "_send", send_or_lose)
    async with thin_link(monkeypatch) as (bench, _, notes, client):
        await until(lambda: client.datagrams is not None and client.datagrams.is_used)
        await show(bench, notes, 5)
        arrives = False
        await show(bench, notes, 5)
        assert not sender_of(client).is_used
        arrives = True
        await until(lambda: sender_of(client).is_used)
        await show(bench, notes, 5)
        check(notes)


async def test_pictures_come_by_tcp_where_no_datagram_ever_arrives_and_both_say_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(DatagramPort, "_send", lambda *_: None)
    monkeypatch.setattr("robot.datagram_sender.OPENS_WITHIN_BEATS", 5)
    monkeypatch.setattr("station.robots.datagrams.OPENS_WITHIN_REPORTS", 5)
    async with thin_link(monkeypatch) as (bench, link, notes, client):
        await show(bench, notes, 5)
        await until(lambda: link._datagrams is not None and link._datagrams.is_blocked)
        await until(lambda: "no datagram reaches" in caplog.text)
        assert not sender_of(client).is_used
        check(notes)
    assert caplog.text.count("no datagram reaches") == caplog.text.count("no datagram comes") == 1


async def test_an_older_robot_without_the_port_sends_by_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DatagramPort, "open", lambda *_: None)
    async with thin_link(monkeypatch) as (bench, link, notes, client):
        await show(bench, notes, 5)
        assert link._datagrams is None and client.datagrams is None


async def test_an_older_station_that_does_not_ask_gets_its_pictures_by_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RobotLink, "_ask_datagrams", lambda *_: None)
    async with thin_link(monkeypatch) as (bench, _, notes, client):
        await show(bench, notes, 5)
        assert client.datagrams is None


async def test_a_taken_udp_port_leaves_everything_to_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    class Taken(socket.socket):
        def bind(self, address: object) -> None:
            if self.type == socket.SOCK_DGRAM:
                raise OSError(98, "Address already in use")
            super().bind(address)  # type: ignore[arg-type]

    monkeypatch.setattr("robot.datagram_port.socket.socket", Taken)
    async with running_robot() as bench, linked(bench.port) as (_, notes):
        await show(bench, notes, 3)
        assert notes.hellos[0].datagram_port == 0


async def test_strangers_and_replays_change_nothing_and_get_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[bytes] = []
    report = PictureDatagrams.report

    def noted(self: PictureDatagrams) -> None:
        sealer = self._sealer
        if sealer is not None and not said:
            seal = sealer.seal
            monkeypatch.setattr(sealer, "seal", lambda content: said.append(seal(content)) or said[-1])
        report(self)

    monkeypatch.setattr(PictureDatagrams, "report", noted)
    async with thin_link(monkeypatch) as (bench, _, notes, client):
        await until(lambda: client.datagrams is not None and client.datagrams.is_used)
        address = sender_of(client)._address
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.2", 0))
            stranger.setblocking(False)
            session = HEADER.unpack_from(said[-1])[0]
            for datagram in (*said, b"", b"x", bytes(2000), HEADER.pack(session, 10**6) + bytes(40)):
                stranger.sendto(datagram, ("127.0.0.1", bench.port))
            await show(bench, notes, 5)
            with pytest.raises(BlockingIOError):
                stranger.recv(2000)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as neighbour:  # on the station's own machine
            neighbour.bind(("127.0.0.1", 0))
            for datagram in said:
                neighbour.sendto(datagram, ("127.0.0.1", bench.port))
            await show(bench, notes, 5)
        assert sender_of(client)._address == address
        check(notes)


async def test_a_station_that_is_soon_back_gets_datagrams_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    async with thin_link(monkeypatch) as (bench, _, _, client):
        await until(lambda: client.datagrams is not None and client.datagrams.is_used)
        assert not sender_of(client)._has_failed
        async with linked(bench.port, "other") as (_, notes):
            second = bench.server._clients[max(bench.server._clients)]
            await until(lambda: second.datagrams is not None)
            assert second.video is not None and not second.video.is_thin, "the first one has not left"
            await show(bench, notes, 1)
        client.end(Event.LOST, notice("shutdown", "away for a moment", fatal=True))
        await until(lambda: client.id not in bench.server._clients and bench.server._clients)
        back = bench.server._clients[max(bench.server._clients)]
        await until(lambda: back.datagrams is not None and back.datagrams.is_used)
