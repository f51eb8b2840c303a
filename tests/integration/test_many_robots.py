"""One station and two robots: each has its own, and what happens to one is not felt by the other."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import websockets

from shared.errors import ConfigError
from station.app import Station
from station.config import StationConfig, load_config, parse_robot
from tests.support.link import Bench, running_robot, until
from tests.support.station import Desk, Film, running_station, store_map


@dataclass
class Lab:
    """A station with two robots that film."""

    desk: Desk
    benches: tuple[Bench, Bench]
    films: tuple[Film, Film]

    async def get(self, path: str) -> Any:
        answer = await self.desk.http.get(path)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def post(self, path: str, **body: Any) -> Any:
        answer = await self.desk.http.post(path, json=body)
        assert answer.status_code < 300, answer.text
        return answer.json()


@asynccontextmanager
async def lab(data_dir: Path, backend: str = "tests.support.made_up_workers:StraightSlam") -> AsyncIterator[Lab]:
    async with AsyncExitStack() as stack:
        benches = [await stack.enter_async_context(running_robot()) for _ in range(2)]
        ports = tuple(bench.port for bench in benches)
        desk = await stack.enter_async_context(running_station(ports, data_dir, backend=backend))
        films = [Film(bench) for bench in benches]
        rolling = [asyncio.create_task(film.run()) for film in films]
        try:
            await until(lambda: all(r.state.connected and r.camera.newest for r in desk.station.robots.values()))
            yield Lab(desk, (benches[0], benches[1]), (films[0], films[1]))
        finally:
            for task in rolling:
                task.cancel()
            await asyncio.gather(*rolling, return_exceptions=True)


async def test_each_robot_is_listed_asked_and_driven_by_its_name(tmp_path: Path) -> None:
    async with lab(tmp_path) as here:
        entries = await here.get("/robots")
        assert [(e["name"], e["path"]) for e in entries] == [
            ("robot-1", "/robots/robot-1"),
            ("robot-2", "/robots/robot-2"),
        ]
        assert [e["robot"]["port"] for e in entries] == [bench.port for bench in here.benches]
        assert (await here.get("/robot"))["port"] == (await here.get("/robots/robot-1"))["port"] == here.benches[0].port
        assert (await here.get("/robots/robot-2"))["port"] == here.benches[1].port

        await here.post("/robots/robot-2/drive", linear=0.2, angular=0.0, ttl_ms=900)
        await until(lambda: not here.benches[1].motors.are_off)
        assert here.benches[0].motors.are_off
        # The wheel of one robot is not the wheel of the other.
        assert (await here.get("/robots/robot-2"))["driver"] is not None and (await here.get("/robot"))[
            "driver"
        ] is None
        await here.post("/robots/robot-2/stop")
        await until(lambda: here.benches[1].motors.are_off)

        missing = await here.desk.http.get("/robots/robot-3/place/current")
        assert missing.status_code == 404 and "GET /robots" in missing.json()["detail"]


async def test_two_robots_record_at_once_and_each_knows_its_own_place(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with lab(tmp_path) as here:
        here.films[1].turn_the_light_out()  # the second robot is elsewhere, for PlaceByLight
        assert (await here.desk.http.put("/maps/active", json={"id": place_map.id})).status_code == 200
        robots = list(here.desk.station.robots.values())

        def knows(number: int, place: str) -> bool:
            report = robots[number].current_place.report
            return report is not None and report.answer.place is not None and report.answer.place.name == place

        await until(lambda: knows(0, place_map.places[0].name) and knows(1, place_map.places[1].name))
        first, second = await here.get("/place/current"), await here.get("/robots/robot-2/place/current")
        assert first["place"]["name"] == place_map.places[0].name
        assert second["place"]["name"] == place_map.places[1].name
        evidence = second["evidence"]["query_image"]
        assert evidence.startswith("/robots/robot-2/") and (await here.desk.http.get(evidence)).status_code == 200

        drives = [await here.post("/navigations", name="A"), await here.post("/robots/robot-2/navigations", name="B")]
        assert [e["navigation"] for e in await here.get("/robots")] == [drive["id"] for drive in drives]
        await until(lambda: all(here.desk.station.navigations.get(drive["id"]).frames >= 8 for drive in drives))
        await here.post(f"/navigations/{drives[1]['id']}/stop")
        assert (await here.get(f"/navigations/{drives[0]['id']}"))["state"] == "recording"
        await here.post(f"/navigations/{drives[0]['id']}/stop")
        ready = ("ready", "failed")
        await until(lambda: all(here.desk.station.navigations.get(drive["id"]).state in ready for drive in drives))
        assert [n["state"] for n in await here.get("/navigations")] == ["ready", "ready"]


async def test_listeners_hear_of_their_robot_and_of_what_all_share(tmp_path: Path) -> None:
    async with (
        lab(tmp_path) as here,
        websockets.connect(here.desk.socket("/ws/events")) as first,
        websockets.connect(here.desk.socket("/robots/robot-2/ws/events")) as second,
    ):
        drive = await here.post("/robots/robot-2/navigations", name="only the second")

        async def hear(socket: websockets.ClientConnection, wanted: Callable[[Any], bool]) -> list[Any]:
            """Everything until what is wanted has come."""
            messages = []
            while not messages or not wanted(messages[-1]):
                messages.append(json.loads(await socket.recv()))
            return messages

        async def hold_the_wheel() -> None:
            while True:
                await here.post("/robots/robot-2/drive", linear=0.1, angular=0.0, ttl_ms=900)
                await asyncio.sleep(0.2)

        driving = asyncio.create_task(hold_the_wheel())
        await hear(second, lambda m: m["type"] == "driver" and m["driver"] is not None)
        await hear(second, lambda m: m["type"] == "pose" and m["slam"]["navigation"] == drive["id"])
        driving.cancel()
        await asyncio.gather(driving, return_exceptions=True)
        await here.post(f"/navigations/{drive['id']}/stop")

        def is_over(m: Any) -> bool:
            return (
                m["type"] == "navigation"
                and m["navigation"]["id"] == drive["id"]
                and m["navigation"]["state"] != "recording"
            )

        of_first = await hear(first, is_over)  # what all share
        assert all(m["slam"]["navigation"] is None for m in of_first if m["type"] == "pose")
        assert all(m["driver"] is None for m in of_first if m["type"] == "driver")


async def test_a_killed_slam_worker_comes_back_and_the_other_robot_does_not_notice(tmp_path: Path) -> None:
    async with lab(tmp_path) as here:
        station = here.desk.station
        drives = [await here.post("/navigations"), await here.post("/robots/robot-2/navigations")]
        first, second = (robot.current_navigation for robot in station.robots.values())
        await until(lambda: all(r.live is not None and r.live.frames > 3 for r in (first, second)))
        assert first.live is not None and second.live is not None
        victim, other = first.slam_pid, second.slam_pid
        assert victim is not None
        os.kill(victim, signal.SIGKILL)
        await until(lambda: first.slam_pid not in (None, victim) and first.live is not None and first.live.restarts)
        assert second.slam_pid == other and second.live.restarts == 0
        assert not any("SLAM" in line.text for line in station.robots["robot-2"].events.log)
        await until(lambda: first.live is not None and first.live.path.num_seen > 4)
        assert first.live.pose is not None and first.live.pose.segment == 1
        for drive in drives:
            await here.post(f"/navigations/{drive['id']}/stop")
        await until(lambda: all(station.navigations.get(d["id"]).state in ("ready", "failed") for d in drives))
        ended = [station.navigations.get(drive["id"]) for drive in drives]
        assert [drive.state for drive in ended] == ["ready", "ready"]
        assert "run SLAM over the recording again" in ended[0].message and "again" not in ended[1].message


async def test_an_error_in_one_robots_session_leaves_the_others_running(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with lab(tmp_path) as here:
        first, second = here.desk.station.robots.values()

        def broken(*_: object) -> None:
            monkeypatch.undo()  # once
            raise RuntimeError("a bug")

        connections = second.state.connections
        monkeypatch.setattr(first.current_navigation, "on_frame", broken)
        await until(lambda: any("a bug" in line.text for line in first.events.log))
        await until(lambda: first.state.connected)
        assert second.state.connected and second.state.connections == connections
        assert not any("bug" in line.text for line in second.events.log)


def test_robots_are_named_by_the_command_or_by_number(tmp_path: Path) -> None:
    robots = (parse_robot("lab=192.168.1.20:7400", "--robot"), parse_robot("192.168.1.21", "--robot"))
    fleet = StationConfig(data_dir=tmp_path, robots=robots).fleet
    assert [(robot.name, robot.host) for robot in fleet] == [("lab", "192.168.1.20"), ("robot-2", "192.168.1.21")]
    assert list(Station(StationConfig(data_dir=tmp_path)).robots) == ["robot-1"]


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ('[[robots]]\nhost = "a"\nname = "x"\n[[robots]]\nhost = "b"\nname = "x"\n', "x is given twice"),
        ('[[robots]]\nhost = "a"\n[[robots]]\nhost = "a"\n', "is given twice"),
        ('[[robots]]\nname = "a/b"\n', "'a/b' is no name"),
        ('[[robots]]\nhost = "auto"\n[[robots]]\nhost = "b"\n', "auto looks for the only robot"),
        ("[[robots]]\nport = 0\n", r"robots\[0\].port = 0"),
        ('[[robots]]\nadress = "a"\n', r"unknown key robots\[0\].adress"),
    ],
)
def test_a_fleet_that_cannot_be_is_refused_by_name(tmp_path: Path, content: str, named: str) -> None:
    path = tmp_path / "station.toml"
    path.write_text(content)
    with pytest.raises(ConfigError, match=named):
        load_config(path)
