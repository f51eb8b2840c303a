"""Whom a station without an address tries, in which order; time is the test's."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import pytest

from shared.private_files import write_private
from station.access.paired_robots import PairedRobot, PairedRobots
from station.robots.link_state import RobotIdentity
from station.robots.search import MAX_TRIED, REFUSED_FOR_S, FoundRobot, RobotSearch

OURS = FoundRobot("sentinel", "192.168.1.20", 7400)
STRANGERS = [FoundRobot(f"stranger-{n}", f"192.168.1.{100 + n}", 7400) for n in range(40)]


class Network:
    """Whoever makes itself known."""

    def __init__(self, robots: Collection[FoundRobot]) -> None:
        self.robots = robots
        self.asked_for: list[Collection[str]] = []

    def find(self, seconds: float, preferred: Collection[str]) -> Collection[FoundRobot]:
        assert seconds > 0
        self.asked_for.append(preferred)
        return self.robots


@pytest.fixture
def paired(tmp_path: Path) -> PairedRobots:
    robots = PairedRobots(tmp_path)
    robots.store(
        PairedRobot(robot_id="sentinel", name="Anna", host="192.168.1.77", port=7400, fingerprint="aa" * 32, token="x")
    )
    return robots


async def test_what_looks_like_a_paired_robot_comes_first_by_its_id_or_its_address(paired: PairedRobots) -> None:
    old_place = FoundRobot("", "192.168.1.77", 7400)
    network = Network([*STRANGERS[:3], OURS, old_place])
    search = RobotSearch(paired, network.find)
    assert [await search.next() for _ in range(2)] == [OURS, old_place]
    assert network.asked_for == [["sentinel"]]


async def test_a_paired_robot_where_it_was_comes_before_all_who_use_its_id(paired: PairedRobots) -> None:
    at_home = FoundRobot("sentinel", "192.168.1.77", 7400)
    liars = [FoundRobot("sentinel", stranger.host, 7400) for stranger in STRANGERS]
    assert await RobotSearch(paired, Network([*liars, at_home]).find).next() == at_home


async def test_each_address_is_tried_before_anybody_is_looked_for_again() -> None:
    network = Network(STRANGERS[:3])
    search = RobotSearch(None, network.find)
    assert {await search.next() for _ in range(3)} == set(STRANGERS[:3])
    assert len(network.asked_for) == 1 and not search.has_more


async def test_who_refused_comes_last_until_a_minute_is_over(paired: PairedRobots) -> None:
    now_s = [0.0]
    liar = FoundRobot("sentinel", "192.168.1.66", 7400)  # anybody may use our robot's id
    search = RobotSearch(paired, Network([liar, OURS, STRANGERS[0]]).find, lambda: now_s[0])
    assert await search.next() == liar
    search.refuse(liar, "not paired")
    search.accept(RobotIdentity("sentinel", b"a"))
    assert [await search.next() for _ in range(3)] == [OURS, STRANGERS[0], liar]
    now_s[0] = REFUSED_FOR_S + 1
    assert await search.next() == liar


async def test_a_crowd_is_tried_in_turns() -> None:
    """Strangers beyond what one round tries are tried in the next ones, and nobody for ever."""
    now_s = [0.0]
    search = RobotSearch(None, Network([*STRANGERS, OURS]).find, lambda: now_s[0])
    tried = []
    for _ in range(3 * MAX_TRIED):
        found = await search.next()
        assert found is not None
        tried.append(found)
        now_s[0] += 1.0
        search.refuse(found, "not paired")
    assert set(tried) == {*STRANGERS, OURS}


async def test_the_first_reason_of_a_round_is_told_with_how_many_others_there_were(paired: PairedRobots) -> None:
    search = RobotSearch(paired, Network([*STRANGERS[:2], OURS]).find)
    said = ""
    for reason in ("the code is old", "not paired", "no answer"):
        found = await search.next()
        assert found is not None
        said = search.refuse(found, reason)
    assert said == "the code is old; 2 more made themselves known, and none took this station in"


def paired_robot(name: str, certificate: str, token: str = "x") -> PairedRobot:
    return PairedRobot(
        robot_id="sentinel", name=name, host=f"{name}.local", port=7400, fingerprint=certificate * 64, token=token
    )


ANNA, BERTA, CARLA = (RobotIdentity("sentinel", bytes.fromhex(digit * 64)) for digit in "abc")


async def met_anna(tmp_path: Path) -> tuple[PairedRobots, RobotSearch]:
    """Paired with Anna and Berta, and Anna took the station in."""
    robots = PairedRobots(tmp_path)
    for name, certificate in (("Anna", "a"), ("Berta", "b")):
        robots.store(paired_robot(name, certificate))
    search = RobotSearch(robots, Network([]).find)
    await search.next()
    assert not search.refusal(ANNA)
    search.accept(ANNA)
    return robots, search


async def test_only_the_robot_that_was_met_is_meant_from_then_on(tmp_path: Path) -> None:
    _, search = await met_anna(tmp_path)
    assert not search.refusal(ANNA) and not search.refusal(RobotIdentity("renamed", ANNA.fingerprint))
    assert "Berta answers, and Anna was found before" in search.refusal(BERTA)
    assert "another robot answers" in search.refusal(RobotIdentity("sentinel", b""))  # shows no certificate at all


async def test_the_robot_that_was_met_is_meant_also_when_it_is_forgotten_until_it_or_another_is_paired(
    tmp_path: Path,
) -> None:
    robots, search = await met_anna(tmp_path)
    robots.forget("Anna")
    for _ in range(2):
        await search.next()
        said = search.refusal(BERTA)
        assert "Berta answers, and Anna was found before, which is not paired any more; start the station" in said
    assert not search.refusal(ANNA)  # that it has to be paired again says who connects to it
    robots.store(paired_robot("Carla", "c"))
    await search.next()
    assert not search.refusal(CARLA) and search.refusal(BERTA)


async def test_who_was_paired_before_the_forgetting_does_not_come_in_its_place(tmp_path: Path) -> None:
    robots, search = await met_anna(tmp_path)
    robots.store(paired_robot("Carla", "c"))
    await search.next()  # Anna was away for a while
    robots.forget("Anna")
    await search.next()
    assert "Carla answers, and Anna was found before" in search.refusal(CARLA)
    robots.store(paired_robot("Carla", "c", token="y"))  # as that says: paired anew
    await search.next()
    assert not search.refusal(CARLA) and search.refusal(BERTA)


@pytest.mark.parametrize("content", [b"damaged", None], ids=["damaged", "away"])
async def test_a_file_of_robots_that_says_nothing_for_a_moment_forgets_nobody(
    tmp_path: Path, content: bytes | None
) -> None:
    robots, search = await met_anna(tmp_path)
    whole = robots.path.rename(tmp_path / "whole")
    if content is not None:
        write_private(robots.path, content)
    await search.next()
    assert "Anna was found before" in search.refusal(BERTA)
    whole.rename(robots.path)
    await search.next()
    assert "Berta answers, and Anna was found before; start the station again" in search.refusal(BERTA)


def test_without_certificates_the_robot_that_was_met_is_known_by_its_id() -> None:
    search = RobotSearch(None, Network([]).find)
    search.accept(RobotIdentity("anna", b""))
    assert "another robot answers, and anna was found before" in search.refusal(RobotIdentity("berta", b""))
    assert not search.refusal(RobotIdentity("anna", b""))
    given_one = RobotIdentity("anna", ANNA.fingerprint)  # by `robot-server access init`; and it was paired then
    assert not search.refusal(given_one)
    search.accept(given_one)
    assert search.refusal(RobotIdentity("anna", b""))
