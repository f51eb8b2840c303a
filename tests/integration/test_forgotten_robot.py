"""A robot that is forgotten while it is connected is left, over real sockets and real TLS."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from shared.access import Role
from station.access import connecting
from station.access.paired_robots import PairedRobots
from station.robots import link as link_module
from tests.support.access import guarded_robot, linked
from tests.support.link import running_robot, until


async def test_a_robot_that_is_forgotten_is_left_at_once_and_its_motors_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "LOOK_EVERY_S", 0.02)
    robots = _CountedLooks(tmp_path / "station")
    async with guarded_robot(tmp_path / "robot") as bench:
        bench.admit("desk", Role.DRIVE, robots)
        async with linked(bench.port, robots) as (link, _):
            await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
            whole = robots.path.read_bytes()
            name = whole.index(b"Robot")
            damaged = whole[:name] + bytes([whole[name] ^ 0x80]) + whole[name + 1 :]
            for content in (b"damaged", damaged, 100_000 * b"["):  # says nothing of who is paired
                robots.path.write_bytes(content)
                looks = robots.looks
                await until(lambda looks=looks: robots.looks > looks + connecting.LOOKS + 1)
                assert link.commands.drive(0.2, 0.0, 250)
            robots.path.write_bytes(whole)
            robots.forget("Robot")
            await until(lambda: link.commands.drive(0.2, 0.0, 250) is False)
            await until(lambda: bench.motors.are_off)
            assert link.state.connections == 1


class _CountedLooks(PairedRobots):
    looks = 0
    sees: tuple[bool, ...] = ()  # at each look, in place of what the file says

    def knows(self, fingerprint: bytes) -> bool:
        self.looks += 1
        return self.sees[self.looks - 1] if self.sees else super().knows(fingerprint)


async def test_a_file_of_robots_that_is_away_for_a_moment_ends_no_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "LOOK_EVERY_S", 0.02)
    robots = _CountedLooks(tmp_path)
    robots.sees = (True, False, True, False, False)
    assert "not paired" in await connecting.until_forgotten(b"", robots)
    assert robots.looks == len(robots.sees)


async def test_whether_it_is_still_paired_is_looked_up_for_a_robot_with_a_certificate_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked_for: list[bytes] = []

    async def until_forgotten(fingerprint: bytes, robots: PairedRobots) -> str:
        asked_for.append(fingerprint)
        return await asyncio.Future[str]()

    monkeypatch.setattr(link_module, "until_forgotten", until_forgotten)
    robots = PairedRobots(tmp_path / "station")
    async with running_robot() as bench, linked(bench.port, robots) as (link, _):
        await until(lambda: link.state.connected)
    assert not asked_for
    async with guarded_robot(tmp_path / "robot") as guarded:
        guarded.admit("desk", Role.DRIVE, robots)
        async with linked(guarded.port, robots) as (link, _):
            await until(lambda: link.state.connected)
        assert asked_for == [guarded.gate.fingerprint]


async def test_a_robot_that_is_forgotten_right_after_a_look_is_left_within_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the pauses between the looks, which leave a fifth of the second for the looks themselves."""
    pauses_s: list[float] = []
    pause = asyncio.sleep

    async def note(seconds: float) -> None:
        pauses_s.append(seconds)
        await pause(0)

    robots = _CountedLooks(tmp_path)
    robots.sees = (True, False, False)
    with monkeypatch.context() as patched:
        patched.setattr(asyncio, "sleep", note)
        await connecting.until_forgotten(b"", robots)
    assert len(pauses_s) == len(robots.sees)
    assert sum(pauses_s[1:]) <= 0.8
