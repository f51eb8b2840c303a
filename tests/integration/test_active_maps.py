"""A robot is looked for in all active maps: by the worker of the station, with the indexes it keeps, and by the API."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest

from shared.geometry import FloatArray, IntArray
from shared.messages import CameraFrame
from station.config import LocalizationConfig
from station.events import Events
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_answer import MapReading, PlaceReport
from station.model.place_map import Grouping, PlaceMap
from station.places.localisation.index_file import index_of
from station.places.localisation.localizer import Localizer
from station.places.localisation.make_index import make_index
from station.places.making.build import build_map
from station.robots.current_place import CurrentPlace
from station.vision.appearance import AppearanceIndex
from station.vision.features import DescriptorArray
from station.workers.places import PlaceFinder
from tests.support.link import hello, until
from tests.support.station import store_map
from tests.support.station_at_work import at_work, is_problem, wait_for
from tests.support.synthetic_home import drive, furnished_room, navigate
from tests.support.walls import CALIBRATION, camera_at, frame, make_map, picture

WORKER_S = 120.0
WALLS = {"Hall": 1, "Attic": 2}  # what is painted on the wall of each


@pytest.fixture(scope="module")
def rooms() -> dict[str, PlaceMap]:
    return {name: build_map(make_map(name, wall).navigation, name=name) for name, wall in WALLS.items()}


POSES = [camera_at(x, 0.1, -0.2, yaw) for yaw in (0.1, -0.3) for x in (-1.4, -0.5, 0.4, 1.3)]


@pytest.fixture(scope="module")
def indexed(rooms: dict[str, PlaceMap], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of the rooms whose indexes are made: that takes a busy machine longer than a test waits for anything."""
    root = tmp_path_factory.mktemp("maps")
    keep(root, rooms)
    for room in rooms.values():
        index_of(root, room, nothing, nothing)
    return root


def nothing() -> None:
    """Nobody is told."""


def keep(root: Path, rooms: dict[str, PlaceMap]) -> None:
    store = MapStore(root)
    for room in rooms.values():
        store.save(room)
    store.close()


def views(wall: int) -> list[bytes]:
    """Of a robot that looks around in a room."""
    return [picture(wall, T_map_cam) for T_map_cam in POSES]


def test_each_room_is_found_by_the_indexes_made_for_it_alone_as_if_it_was_the_only_one(
    rooms: dict[str, PlaceMap],
) -> None:
    indexes = {name: make_index(room) for name, room in rooms.items()}
    together = Localizer(list(rooms.values()), index=list(indexes.values()))
    for name, room in rooms.items():
        alone = Localizer([room], index=[indexes[name]])
        for view in views(WALLS[name])[::3]:
            found, expected = (one.localize(frame(view), CALIBRATION) for one in (together, alone))
            assert found is not None and expected is not None and found.map_id == room.id
            assert np.allclose(found.T_map_cam, expected.T_map_cam, atol=1e-3)


def test_a_map_that_thinks_it_knows_every_picture_does_not_hide_the_others(
    rooms: dict[str, PlaceMap], monkeypatch: pytest.MonkeyPatch
) -> None:
    localizer = Localizer(list(rooms.values()))
    boaster, asked = localizer.appearances[0], AppearanceIndex.query

    def boast(index: AppearanceIndex, descriptors: DescriptorArray, count: int) -> tuple[IntArray, FloatArray]:
        images, similarity = asked(index, descriptors, count)
        return images, np.ones(len(similarity)) if index is boaster else similarity

    monkeypatch.setattr(AppearanceIndex, "query", boast)
    found = localizer.localize(frame(views(WALLS["Attic"])[0]), CALIBRATION)
    assert found is not None and found.map_id == rooms["Attic"].id


class Robot:
    """Pictures of it go to a real localisation worker; how it answered."""

    def __init__(self, root: Path) -> None:
        self.events = Events()
        self.reports: list[PlaceReport] = []
        self.place = CurrentPlace(
            StoreAddress(root), LocalizationConfig(rate_hz=30), self.events, on_report=self.reports.append
        )
        self._seq = 0

    async def look_in(self, *maps: PlaceMap) -> None:
        """Until the worker is ready: the first one of a busy machine loads its libraries for half a minute."""
        await self.place.use_maps(tuple(one.id for one in maps))
        first = CameraFrame(seq=0, t_robot_ns=0, exposure_ns=0, width=640, height=480, skipped=0, jpeg=b"")
        self.place.on_frame(first, 0)
        async with asyncio.timeout(WORKER_S):
            while "localisation is ready" not in self.said("place"):
                await asyncio.sleep(0.02)

    async def look(self, views: Sequence[bytes], from_s: float) -> PlaceReport:
        """One picture in a while, so that none is compared with the one before; the answer to the last one."""
        for number, view in enumerate(views):
            t_robot_ns = round((from_s + 4 * number) * 1e9)
            self._seq += 1
            shown = CameraFrame(
                seq=self._seq, t_robot_ns=t_robot_ns, exposure_ns=0, width=640, height=480, skipped=0, jpeg=view
            )
            wanted = self.place.answers + 1
            self.place.on_frame(shown, 0)
            await until(partial(self._has_answered, wanted))
        return self.reports[-1]

    def _has_answered(self, times: int) -> bool:
        return self.place.answers >= times

    def said(self, topic: str) -> list[str]:
        return [line.text for line in self.events.log if line.topic == topic]


@pytest.fixture
async def robot(tmp_path: Path, indexed: Path) -> AsyncIterator[Robot]:
    shutil.copytree(indexed, tmp_path, dirs_exist_ok=True)
    robot = Robot(tmp_path)
    running = asyncio.create_task(robot.place.run())
    robot.place.on_connected(msgspec.structs.replace(hello(), calibration=CALIBRATION))
    yield robot
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    await robot.place.close()


async def test_a_robot_carried_off_to_another_map_is_found_there_and_the_event_says_so(
    robot: Robot, rooms: dict[str, PlaceMap]
) -> None:
    hall, attic = rooms.values()
    await robot.look_in(hall, attic)
    before = await robot.look(views(WALLS["Hall"])[:4], 1.0)
    assert before.map_id == before.answer.map_id == hall.id and before.answer.state == "known"
    assert before.answer.place is not None and before.answer.place.id in {place.id for place in hall.places}
    after = await robot.look(views(WALLS["Attic"]), 20.0)
    assert after.map_id == after.answer.map_id == attic.id and after.answer.state == "known"
    assert after.answer.place is not None and after.answer.place.id in {place.id for place in attic.places}
    assert after.T_map_cam is not None and np.allclose(after.T_map_cam[:3, 3], POSES[-1][:3, 3], atol=0.03)
    position = after.answer.position_map  # in the attic's frame
    assert position is not None and np.allclose(position, after.T_map_cam[:3, 3], atol=0.3)
    assert robot.said("hijack") == ["the robot was picked up: recognised in another map than it was in"]


async def test_a_map_that_went_is_left_out_by_the_worker_and_the_other_answers(
    robot: Robot, tmp_path: Path, rooms: dict[str, PlaceMap]
) -> None:
    hall, attic = rooms.values()
    store = MapStore(tmp_path)
    store.delete(hall.id)
    store.close()
    await robot.look_in(hall, attic)
    answer = await robot.look(views(WALLS["Attic"])[:4], 1.0)
    assert answer.map_id == attic.id and answer.answer.state == "known"
    [line] = [text for text in robot.said("place") if "not looked for" in text]
    assert hall.id in line


def test_the_worker_tells_how_far_all_maps_are_and_takes_the_new_names_of_one(
    tmp_path: Path, rooms: dict[str, PlaceMap]
) -> None:
    keep(tmp_path, rooms)
    told: list[object] = []
    finder = PlaceFinder(told.append)
    finder.load(StoreAddress(tmp_path), tuple(room.id for room in rooms.values()))
    readings = [event for event in told if isinstance(event, MapReading)]
    assert [reading.fraction for reading in readings] == sorted(reading.fraction for reading in readings)
    assert readings[0].text == "looking at picture 1 of 7 of Hall" and readings[-1].text.endswith("7 of 7 of Attic")
    finder.calibrate(CALIBRATION)
    attic = rooms["Attic"]
    upper = tuple(replace(place, name=f"{place.name} up") for place in attic.places)
    finder.regroup(Grouping.of(replace(attic, places=upper)))
    frames = [replace(frame(view), t_robot_ns=4_000_000_000 * k) for k, view in enumerate(views(WALLS["Attic"])[:4])]
    answers = [finder.answer(one).answer for one in frames]
    names = {candidate.name for candidate in answers[-1].alternatives}
    assert answers[-1].place is not None and answers[-1].place.name.endswith(" up")
    assert {place.name for place in rooms["Hall"].places} <= names


async def test_a_set_is_chosen_listed_asked_and_refused_by_http(tmp_path: Path) -> None:
    room, attic = store_map(tmp_path), store_other_map(tmp_path)
    store = MapStore(tmp_path / "maps")
    store.save(replace(room, id="map-again", name="Once more"))
    store.close()
    async with at_work(tmp_path) as (desk, _, film):
        http = desk.http
        assert is_problem(await http.put("/maps/active", json={"id": None, "also": [attic.id]}), 422)
        assert is_problem(await http.put("/maps/active", json={"id": room.id, "also": ["none"]}), 404)
        refused = await http.put("/maps/active", json={"id": room.id, "also": [attic.id, "map-again"]})
        assert is_problem(refused, 409) and "maps of the same rooms" in refused.json()["detail"]
        assert not any(listed["active"] for listed in (await http.get("/maps")).json())

        chosen = (await http.put("/maps/active", json={"id": room.id, "also": [attic.id]})).json()
        assert (chosen["id"], chosen["active"], chosen["first"]) == (room.id, True, True)
        listed = {each["id"]: (each["active"], each["first"]) for each in (await http.get("/maps")).json()}
        assert listed == {room.id: (True, True), attic.id: (True, False), "map-again": (False, False)}
        assert [place["id"] for place in (await http.get("/places")).json()] == [place.id for place in room.places]
        assert (await http.get("/graph")).json()["map"] == room.id

        here = await wait_for(desk, "/place/current", lambda p: p["state"] == "known")
        assert here["map"] == here["alternatives"][0]["map"] == room.id and here["place"]["id"] == room.places[0].id
        film.turn_the_light_out()  # PlaceByLight: in the other map
        there = await wait_for(desk, "/place/current", lambda p: p["map"] == attic.id)
        assert there["place"] == {"id": attic.places[1].id, "name": attic.places[1].name}
        assert there["position_map"] == attic.places[1].centroid_map.tolist()
        assert there["alternatives"][0]["name"] == attic.places[0].name
        assert there["evidence"]["map_image"] == f"/maps/{attic.id}/images/3.jpg"
        assert (await http.patch(f"/places/{room.places[1].id}", json={"name": "Sofa"})).json()["name"] == "Sofa"

        assert is_problem(await http.delete(f"/maps/{room.id}"), 409)
        assert (await http.delete(f"/maps/{attic.id}")).status_code == 204
        assert any("is left out" in line["text"] for line in (await http.get("/log")).json())
        back = await wait_for(desk, "/place/current", lambda p: p["state"] == "known")
        assert back["map"] == room.id and back["place"]["name"] == "Sofa"
        alone = (await http.put("/maps/active", json={"id": "map-again"})).json()
        assert alone["first"] and [m["id"] for m in (await http.get("/maps")).json() if m["active"]] == ["map-again"]


def store_other_map(data_dir: Path) -> PlaceMap:
    """Of another made-up room, that another drive went through."""
    home = furnished_room(5)
    navigation = replace(navigate(home, drive(home, 5), 5), id="nav-attic")
    place_map = build_map(navigation, name="Attic")
    store = MapStore(data_dir / "maps")
    store.save(place_map)
    store.close()
    return place_map
