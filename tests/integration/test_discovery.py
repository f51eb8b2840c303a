"""A robot that makes itself known is found; loopback addresses stay private."""

from __future__ import annotations

import asyncio
import itertools
import socket

import pytest

from robot import announce
from robot.announce import Announcement, announced_addresses
from station.robots.discovery import find_robot
from station.robots.link import RobotLink
from tests.support.link import Notes, running_robot, until

LOOPBACK = ["127.0.0.1"]


def test_loopback_and_host_names_are_not_announced() -> None:
    assert announced_addresses("127.0.0.1") == announced_addresses("::1") == announced_addresses("my-robot") == []
    assert announced_addresses("192.168.1.20") == ["192.168.1.20"]


def test_an_announced_robot_is_found_and_a_closed_one_is_not() -> None:
    port = _free_port()
    announcement = Announcement(f"robot-{port}", port, lambda: LOOPBACK, interfaces=LOOPBACK)
    try:
        found = find_robot(10.0, LOOPBACK)
        if found is None:
            pytest.skip("this machine passes no multicast on its loopback interface")
        assert found == ("127.0.0.1", port)
    finally:
        announcement.close()
    while find_robot(1.0, LOOPBACK) == ("127.0.0.1", port):
        continue  # the goodbye takes its time; a robot that never says it fails here by the test's own time limit


def test_a_robot_that_starts_before_its_network_is_announced_when_it_has_an_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(announce, "LOOK_AGAIN_S", 0.01)
    port, asked = _free_port(), itertools.count()
    announcement = Announcement(f"robot-{port}", port, lambda: LOOPBACK if next(asked) > 2 else [], LOOPBACK)
    try:
        found = find_robot(10.0, LOOPBACK)
        if found is None:
            pytest.skip("this machine passes no multicast on its loopback interface")
        assert found == ("127.0.0.1", port)
    finally:
        announcement.close()


async def test_the_link_looks_for_a_robot_until_there_is_one() -> None:
    answers: list[tuple[str, int] | None] = [None, None]
    async with running_robot() as bench:
        link = RobotLink("auto", 0, Notes(), find=lambda _: answers.pop(0) if answers else ("127.0.0.1", bench.port))
        task = asyncio.create_task(link.run())
        await until(lambda: "no robot makes itself known" in link.state.reason)
        await until(lambda: link.state.connected)
        assert (link.state.host, link.state.port) == ("127.0.0.1", bench.port)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port: int = taken.getsockname()[1]
        return port
