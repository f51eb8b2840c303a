"""A robot that makes itself known is found; loopback addresses stay private."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import ifaddr
import pytest
from zeroconf import ServiceInfo, Zeroconf

from robot import announce
from robot.announce import Announcement, announced_addresses
from shared.access import Role
from shared.discovery import SERVICE_TYPE
from station.access.paired_robots import PairedRobots
from station.robots.discovery import MAX_SERVICES, chosen, find_robots
from station.robots.link import RobotLink
from station.robots.search import FoundRobot
from tests.support.access import guarded_robot
from tests.support.link import Notes, running_robot, until

LOOPBACK = ["127.0.0.1"]


def test_loopback_and_host_names_are_not_announced() -> None:
    assert announced_addresses("127.0.0.1") == announced_addresses("::1") == announced_addresses("my-robot") == []
    assert announced_addresses("192.168.1.20") == ["192.168.1.20"]


@pytest.mark.parametrize(
    ("host", "ips", "announced"),
    [
        ("0.0.0.0", ["127.0.0.1", "169.254.7.8", ("fe80::2", 0, 2)], ["169.254.7.8"]),
        ("0.0.0.0", ["127.0.0.1", ("::1", 0, 0), ("fd00::2", 0, 0)], []),
        ("::", ["127.0.0.1", ("::1", 0, 0), ("fd00::2", 0, 0), ("fe80::2", 0, 2)], ["fd00::2", "fe80::2"]),
        ("::", ["10.0.0.1", ("fd00::2", 0, 0)], ["10.0.0.1"]),
    ],
)
def test_a_network_without_a_router_has_addresses_too(
    monkeypatch: pytest.MonkeyPatch, host: str, ips: list[str | tuple[str, int, int]], announced: list[str]
) -> None:
    adapter = ifaddr.Adapter("eth0", "eth0", [ifaddr.IP(ip, 24, "eth0") for ip in ips])
    monkeypatch.setattr(ifaddr, "get_adapters", lambda: [adapter])
    monkeypatch.setattr(announce, "_leading_out", lambda *_: [])
    assert announced_addresses(host) == announced


def test_an_announced_robot_is_found_and_a_closed_one_is_not() -> None:
    port = _free_port()
    announcement = Announcement(f"robot-{port}", port, lambda: LOOPBACK, interfaces=LOOPBACK)
    try:
        assert_found(port)
    finally:
        announcement.close()
    while FoundRobot(f"robot-{port}", "127.0.0.1", port) in find_robots(1.0, interfaces=LOOPBACK):
        continue  # the goodbye takes its time; a robot that never says it fails here by the test's own time limit


@contextlib.contextmanager
def shouted(packet: bytes) -> Iterator[None]:
    """A stranger says this again and again."""
    is_over = threading.Event()

    def shout() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
                stranger.setsockopt(socket.SOL_SOCKET, option, 1)
            stranger.bind(("127.0.0.1", 5353))
            stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            while not is_over.wait(0.05):
                with contextlib.suppress(OSError):
                    stranger.sendto(packet, ("224.0.0.251", 5353))

    shouting = threading.Thread(target=shout)
    shouting.start()
    try:
        yield
    finally:
        is_over.set()
        shouting.join()


def answer_of(service: bytes, host: bytes) -> bytes:
    """A robot of this name at a host of that one; each is a label of a name, whose bytes DNS leaves free (RFC 1035)."""
    kind = [label.encode() for label in SERVICE_TYPE.strip(".").split(".")]

    def name(*labels: bytes) -> bytes:
        return b"".join(bytes([len(label)]) + label for label in labels) + b"\0"

    def record(owner: bytes, number: int, data: bytes) -> bytes:
        return owner + struct.pack(">HHIH", number, 1, 120, len(data)) + data

    pointer = record(name(*kind), 12, name(service, *kind))
    place = record(name(service, *kind), 33, struct.pack(">HHH", 0, 0, 7400) + name(host, b"local"))
    return struct.pack(">6H", 0, 0x8400, 0, 2, 0, 0) + pointer + place


@pytest.mark.parametrize("service", [b"evil", b"\xff" * 60], ids=["its host", "and its own"])
def test_a_stranger_whose_name_is_no_text_hides_no_other(service: bytes, caplog: pytest.LogCaptureFixture) -> None:
    """Read as text it is longer than a name may be, and zeroconf raises where it asks for it."""
    port = _free_port()
    announcement = Announcement(f"robot-{port}", port, lambda: LOOPBACK, interfaces=LOOPBACK)
    try:
        assert_found(port)
        time.sleep(1.1)  # who has just answered all says it again a second later (RFC 6762, section 6)
        with shouted(answer_of(service, b"\xff" * 60)):
            assert FoundRobot(f"robot-{port}", "127.0.0.1", port) in find_robots(10.0, [f"robot-{port}"], LOOPBACK)
    finally:
        announcement.close()
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]


def test_a_machine_without_any_address_finds_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ifaddr, "get_adapters", list)
    assert find_robots(0.1) == ()


def test_a_robot_that_starts_before_its_network_is_announced_when_it_has_an_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(announce, "LOOK_AGAIN_S", 0.01)
    port, asked = _free_port(), itertools.count()
    announcement = Announcement(f"robot-{port}", port, lambda: LOOPBACK if next(asked) > 2 else [], LOOPBACK)
    try:
        assert_found(port)
    finally:
        announcement.close()


def test_a_robots_own_name_is_looked_up_before_longer_ones_that_begin_with_it() -> None:
    own = f"robot.{SERVICE_TYPE}"
    others = [f"robot {n}.{SERVICE_TYPE}" for n in range(10 * MAX_SERVICES)]
    for _ in range(5):
        services = chosen([*others, own, f"anna.{SERVICE_TYPE}"], ("robot",))
        assert services[0].name == own and len(services) == MAX_SERVICES


def test_who_answers_with_many_names_does_not_hide_a_robot_that_was_paired() -> None:
    port = _free_port()
    announcement = Announcement(f"robot-{port}", port, lambda: LOOPBACK, interfaces=LOOPBACK)
    crowd = Zeroconf(interfaces=LOOPBACK)
    try:
        assert_found(port)
        strangers = [
            ServiceInfo(SERVICE_TYPE, f"a{n}.{SERVICE_TYPE}", port=1, parsed_addresses=LOOPBACK, server=f"a{n}.local.")
            for n in range(3 * MAX_SERVICES)
        ]
        for stranger in strangers:
            crowd.registry.async_add(stranger)  # answered for from now on, without its seconds of announcing
        for _ in range(3):
            found = find_robots(10.0, [f"robot-{port}"], LOOPBACK)
            assert FoundRobot(f"robot-{port}", "127.0.0.1", port) in found
    finally:
        crowd.close()
        announcement.close()


async def test_a_stranger_that_answers_first_does_not_keep_a_paired_robot_from_being_found(tmp_path: Path) -> None:
    """One that is not paired, one that says nothing, one where nothing listens: all come first, with our robot's id."""
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "ours") as ours, guarded_robot(tmp_path / "strange") as stranger:
        ours.admit("desk", Role.DRIVE, robots)
        mute = socket.create_server(("127.0.0.1", 0))
        ports = [stranger.port, mute.getsockname()[1], _free_port(), ours.port]
        link = RobotLink(
            "auto", 0, Notes(), find=lambda *_: [FoundRobot("r", "127.0.0.1", port) for port in ports], robots=robots
        )
        task = asyncio.create_task(link.run())
        try:
            await until(lambda: link.state.connected)
            assert link.state.port == ours.port
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            mute.close()


async def test_who_looks_for_a_robot_stays_with_the_one_it_found(tmp_path: Path) -> None:
    """Another one in its place would be driven by whoever drove the first."""
    robots = PairedRobots(tmp_path / "station")
    async with guarded_robot(tmp_path / "first") as first, guarded_robot(tmp_path / "second") as second:
        for bench in (first, second):
            bench.admit("desk", Role.DRIVE, robots)
        around = [first.port]
        link = RobotLink(
            "auto", 0, Notes(), find=lambda *_: [FoundRobot("r", "127.0.0.1", port) for port in around], robots=robots
        )
        task = asyncio.create_task(link.run())
        try:
            await until(lambda: link.state.connected)
            around[:] = [second.port]
            await first.stop()
            await until(lambda: "was found before" in link.state.reason)
            assert not second.heard
            around[:] = [second.port, first.port]
            await first.start()
            await until(lambda: link.state.connected)
            assert link.state.port == first.port and not second.heard
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def test_the_link_looks_for_a_robot_until_there_is_one() -> None:
    answers: list[list[FoundRobot]] = [[], []]
    async with running_robot() as bench:
        here = [FoundRobot("r", "127.0.0.1", bench.port)]
        link = RobotLink("auto", 0, Notes(), find=lambda *_: answers.pop(0) if answers else here)
        task = asyncio.create_task(link.run())
        await until(lambda: "no robot makes itself known" in link.state.reason)
        await until(lambda: link.state.connected)
        assert (link.state.host, link.state.port) == ("127.0.0.1", bench.port)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def assert_found(port: int) -> None:
    found = find_robots(10.0, interfaces=LOOPBACK)
    if not found:
        pytest.skip("this machine passes no multicast on its loopback interface")
    assert FoundRobot(f"robot-{port}", "127.0.0.1", port) in found


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port: int = taken.getsockname()[1]
        return port
