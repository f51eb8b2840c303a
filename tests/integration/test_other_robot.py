"""Another robot takes the place of the one that is driven, while the joystick is held: it must not move."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec
import pytest

from robot.config import IdentityConfig
from shared.access import Role
from shared.messages import Capabilities, Drive
from station.access.paired_robots import PairedRobot, PairedRobots
from station.access.visitors import access_folder
from station.config import DriveConfig
from station.errors import Conflict, NoRobot
from station.robots.driving import Driving
from station.robots.link import RobotLink
from station.robots.search import FoundRobot
from tests.support.access import GuardedBench, guarded_robot, make_token
from tests.support.link import Bench, Notes, Proxy, linked, running_robot, until
from tests.support.station import running_station

LET_GO = "let go of the joystick once"


class Joystick:
    """A hand that holds on; keeps the newest words with which it was refused."""

    def __init__(self, driving: Driving) -> None:
        self._driving = driving
        self.refusal = ""

    async def hold(self) -> None:
        while True:
            try:
                self._driving.drive("joe", 0.2, 0.0, 250)
                self.refusal = ""
            except (Conflict, NoRobot) as exc:
                self.refusal = str(exc)
            await asyncio.sleep(0.02)

    def let_go(self) -> None:
        self._driving.drive("joe", 0.0, 0.0, 250)


@asynccontextmanager
async def held(driving: Driving) -> AsyncIterator[Joystick]:
    joystick = Joystick(driving)
    holding = asyncio.create_task(joystick.hold())
    try:
        yield joystick
    finally:
        assert not holding.done(), "the hand let go by itself"
        holding.cancel()


def was_driven(bench: Bench) -> bool:
    return any(isinstance(message, Drive) for message in bench.heard)


def moves(bench: Bench) -> bool:
    return bool(bench.motors.history) and not bench.motors.are_off


@asynccontextmanager
async def called(robot_id: str) -> AsyncIterator[Bench]:
    """A robot without access control, by another id than its host's name."""
    bench = Bench()
    bench.config = msgspec.structs.replace(bench.config, identity=IdentityConfig(id=robot_id))
    await bench.start()
    try:
        yield bench
    finally:
        await bench.stop()


async def exchange(proxy: Proxy, robot: Bench) -> None:
    """From now on this robot answers at the proxy's address."""
    await proxy.cut()
    proxy.target_port = robot.port
    await proxy.mend()


def pair_at(port: int, robot: GuardedBench, name: str, robots: PairedRobots) -> None:
    """As `station pair` does, for a robot that answers at this port."""
    fingerprint, token = robot.gate.fingerprint.hex(), make_token(robot, Role.DRIVE).text
    robots.store(
        PairedRobot(robot_id=name.lower(), name=name, host="127.0.0.1", port=port, fingerprint=fingerprint, token=token)
    )


@pytest.mark.parametrize("same_name", [True, False])
async def test_a_robot_that_is_paired_at_anothers_address_is_not_moved_by_a_hand_that_holds_on(
    tmp_path: Path, same_name: bool
) -> None:
    async with guarded_robot(tmp_path / "a") as anna, guarded_robot(tmp_path / "b") as berta:
        proxy = Proxy(anna.port)
        await proxy.mend()
        robots = PairedRobots(access_folder(tmp_path / "station"))
        pair_at(proxy.port, anna, "Anna", robots)
        async with running_station(proxy.port, tmp_path / "station") as desk:
            robot = desk.station.first
            await until(lambda: robot.state.connected)
            async with held(robot.driving) as joystick:
                await until(lambda: moves(anna))
                await exchange(proxy, berta)
                await until(lambda: "no robot is connected" in joystick.refusal and not moves(anna))
                pair_at(proxy.port, berta, "Anna" if same_name else "Berta", robots)
                await until(lambda: robot.state.connected and LET_GO in joystick.refusal)
                assert not was_driven(berta)
                joystick.let_go()
                await until(lambda: moves(berta))
        await proxy.cut()


async def test_another_robot_without_tls_at_the_same_address_is_not_moved_by_a_hand_that_holds_on(
    tmp_path: Path,
) -> None:
    async with running_robot() as anna, called("berta") as berta:
        proxy = Proxy(anna.port)
        await proxy.mend()
        async with running_station(proxy.port, tmp_path) as desk:
            robot = desk.station.first
            await until(lambda: robot.state.connected)
            async with held(robot.driving) as joystick:
                await until(lambda: moves(anna))
                await exchange(proxy, berta)
                await until(lambda: robot.state.connections == 2 and LET_GO in joystick.refusal)
                assert not was_driven(berta)
                await exchange(proxy, anna)  # the one that is meant: no need to let go
                anna.heard.clear()
                await until(lambda: was_driven(anna))
        await proxy.cut()


@asynccontextmanager
async def looking_for(robots: PairedRobots | None, around: list[int]) -> AsyncIterator[tuple[RobotLink, Driving]]:
    """A station that was given no address; `around` are the ports of the robots that make themselves known."""
    link = RobotLink(
        "auto", 0, Notes(), find=lambda *_: [FoundRobot("r", "127.0.0.1", port) for port in around], robots=robots
    )

    def able() -> Capabilities | None:
        state = link.state
        return state.hello.capabilities if state.connected and state.hello else None

    driving = Driving(
        link.commands,
        DriveConfig(),
        able,
        lambda: link.state.robot,
        lambda _: None,
        lambda _: None,
        why_alone=lambda: link.state.reason,
    )
    tasks = [asyncio.create_task(part) for part in (link.run(), driving.run())]
    try:
        await until(lambda: link.state.connected)
        yield link, driving
    finally:
        assert not any(task.done() for task in tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def test_where_the_robot_that_was_found_is_forgotten_no_other_one_is_met_or_moved(tmp_path: Path) -> None:
    robots = PairedRobots(tmp_path / "station")
    async with (
        guarded_robot(tmp_path / "a") as anna,
        guarded_robot(tmp_path / "b") as berta,
        guarded_robot(tmp_path / "c") as carla,
    ):
        around = [anna.port]
        pair_at(anna.port, anna, "Anna", robots)
        pair_at(berta.port, berta, "Berta", robots)
        async with looking_for(robots, around) as (link, driving), held(driving) as joystick:
            await until(lambda: moves(anna))
            around[:] = [berta.port, carla.port]
            robots.forget("Anna")
            await until(lambda: "Anna was found before, which is not paired any more" in joystick.refusal)
            assert not moves(anna) and not berta.heard
            pair_at(carla.port, carla, "Carla", robots)  # that is to say that it is meant now
            await until(lambda: link.state.connected and LET_GO in joystick.refusal)
            assert link.state.port == carla.port and not was_driven(carla) and not berta.heard
            joystick.let_go()
            await until(lambda: moves(carla))


async def test_without_tls_another_robot_that_makes_itself_known_is_not_taken_for_the_one_that_was_found() -> None:
    async with called("anna") as anna, called("berta") as berta:
        around = [anna.port]
        async with looking_for(None, around) as (link, driving), held(driving) as joystick:
            await until(lambda: moves(anna))
            around[:] = [berta.port]
            await anna.stop()
            await until(lambda: "anna was found before" in joystick.refusal)
            assert link.state.connections == 1 and not berta.heard


async def test_a_stop_that_the_first_robot_has_not_confirmed_is_not_said_to_another_one() -> None:
    async with running_robot() as anna, called("berta") as berta:
        proxy = Proxy(anna.port)
        await proxy.mend()
        async with linked(proxy.port) as (link, _):
            proxy.stall()
            link.commands.stop(until_confirmed=True)
            await exchange(proxy, berta)
            proxy.flow()
            await until(lambda: link.state.connections == 2)
            assert not link.commands.awaits_stop and not berta.stops_heard
        await proxy.cut()
