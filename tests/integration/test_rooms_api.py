"""Rooms over HTTP: listed, named, drawn, taken back; bad input becomes a problem and changes nothing."""

from __future__ import annotations

from pathlib import Path

from tests.support.made_up_workers import BehindAWall, InADoorway, OneOfTwoRooms
from tests.support.station import DRAWN, store_map, store_planned_map, store_split_map
from tests.support.station_at_work import at_work, is_problem, wait_for


async def test_rooms_are_listed_named_drawn_and_taken_back(tmp_path: Path) -> None:
    planned = store_planned_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        http = desk.http
        await http.put("/maps/active", json={"id": planned.id})
        lounge, other = (await http.get("/rooms")).json()
        assert (lounge["name"], lounge["doors"]) == ("Living room", ["door-lk"])
        assert len(lounge["places"]) == len(planned.places) and lounge["suggestions"] == []
        assert [(s["name"], s["source"]) for s in other["suggestions"]] == [("Kitchen", "sticker")]
        assert (await http.get("/places")).json()[0]["room"] == "room-l"
        named = (await http.patch("/rooms/room-k", json={"name": " Kitchen "})).json()
        assert (named["name"], named["named"], named["suggestions"]) == ("Kitchen", True, [])
        plan = (await http.get("/floorplan")).json()
        assert [room["name"] for room in plan["rooms"]] == ["Living room", "Kitchen"]
        assert plan["metric"] and len(plan["places"]) == len(planned.places)
        for form, begin in (("svg", b"<svg"), ("png", b"\x89PNG"), ("geojson", b'{"type": "FeatureCollection"')):
            assert (await http.get("/floorplan", params={"format": form})).content.startswith(begin)
        assert (await http.get("/places/changes")).json()[0]["why"] == "Room 2 is Kitchen now"
        await http.post("/places/undo")
        assert (await http.get("/rooms/room-k")).json()["name"] == "Room 2"


async def test_a_rooms_name_is_taken_from_it_and_given_back(tmp_path: Path) -> None:
    planned = store_planned_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        http = desk.http
        await http.put("/maps/active", json={"id": planned.id})
        await http.patch("/rooms/room-k", json={"name": "Pantry"})
        cleared = (await http.patch("/rooms/room-k", json={"name": None})).json()
        assert (cleared["name"], cleared["named"]) == ("Room 2", False)
        assert (await http.get("/places/changes")).json()[0]["why"] == "Pantry has no name any more"
        await http.post("/places/undo")
        back = (await http.get("/rooms/room-k")).json()
        assert (back["name"], back["named"]) == ("Pantry", True)
        assert is_problem(await http.patch("/rooms/room-k", json={}), 422)
        assert is_problem(await http.patch("/rooms/room-k", json={"name": ""}), 422)


async def test_a_place_says_of_which_room_it_is_now_and_an_answer_whether_it_is_withheld(tmp_path: Path) -> None:
    planned = store_planned_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        await desk.http.put("/maps/active", json={"id": planned.id})
        answer = await wait_for(desk, "/place/current", lambda a: a["place"])
        assert answer["place"].keys() == {"id", "name"} and answer["place_room"] == "room-l"
        assert answer["place_elsewhere"] is False  # no room is named that it could belong to or not
        assert answer["withheld"] is False


async def test_an_answer_and_a_visit_say_that_a_place_is_of_another_room_than_the_robot_is_in(tmp_path: Path) -> None:
    planned = store_planned_map(tmp_path)
    async with at_work(tmp_path, place_program=BehindAWall) as (desk, _, _):
        await desk.http.put("/maps/active", json={"id": planned.id})
        answer = await wait_for(desk, "/place/current", lambda a: a["place"])
        visit = (await desk.http.get("/place/timeline")).json()[-1]
        for said in (answer, visit):
            assert (said["place_room"], said["room"]["id"], said["place_elsewhere"]) == ("room-l", "room-k", True)


async def test_in_a_doorway_both_rooms_are_told_and_no_door_that_was_erased_meanwhile(tmp_path: Path) -> None:
    planned = store_split_map(tmp_path)
    async with at_work(tmp_path, place_program=InADoorway) as (desk, _, film):
        http = desk.http
        await http.put("/maps/active", json={"id": planned.id})
        answer = await wait_for(desk, "/place/current", lambda a: a["doorway"])
        first, second = (await http.get("/rooms")).json()
        assert (answer["room"]["id"], answer["room_alternatives"][0]["id"]) == (first["id"], second["id"])
        [door] = (await http.get("/floorplan")).json()["doors"]
        assert answer["doorway"] == door["id"]
        film.pause()  # the answer stays the one of before
        await http.delete(f"/doors/{door['id']}")
        after = (await http.get("/place/current")).json()
        assert (after["doorway"], after["room_alternatives"]) == (None, [])


async def test_of_two_rooms_that_look_alike_both_are_told_and_none_is_named(tmp_path: Path) -> None:
    planned = store_planned_map(tmp_path)
    async with at_work(tmp_path, place_program=OneOfTwoRooms) as (desk, _, _):
        await desk.http.put("/maps/active", json={"id": planned.id})
        answer = await wait_for(desk, "/place/current", lambda a: a["one_of_two"])
        assert answer["room"] is None and answer["place"] is None
        assert [(one["name"], one["probability"]) for one in answer["one_of_two"]] == [
            ("Living room", 0.5),
            ("Room 2", 0.45),
        ]
        assert answer["room_alternatives"] == answer["one_of_two"]
        await desk.http.patch("/rooms/room-k", json={"name": "Kitchen"})
        renamed = (await desk.http.get("/place/current")).json()
        assert [one["name"] for one in renamed["one_of_two"]] == ["Living room", "Kitchen"]


async def test_rooms_are_made_one_and_parted_again(tmp_path: Path) -> None:
    split = store_split_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        http = desk.http
        await http.put("/maps/active", json={"id": split.id})
        before = (await http.get("/rooms")).json()
        first, second = before
        await http.patch(f"/rooms/{first['id']}", json={"name": "Hall"})
        merged = (await http.post("/rooms/merge", json={"rooms": [first["id"], second["id"]]})).json()
        assert (merged["id"], merged["name"]) == (first["id"], "Hall")
        assert merged["area_m2"] > first["area_m2"] + 0.5 * second["area_m2"]
        parted = (await http.post("/rooms/split", json={"line": DRAWN.tolist()})).json()
        assert [room["area_m2"] for room in parted] == [room["area_m2"] for room in before]
        (door,) = parted[1]["doors"]
        (whole,) = (await http.delete(f"/doors/{door}")).json()
        assert whole["area_m2"] == merged["area_m2"]
        await http.post("/places/undo")
        assert len((await http.get("/rooms")).json()) == 2


async def test_a_name_stays_with_the_smaller_half_of_a_room_that_was_two(tmp_path: Path) -> None:
    split = store_split_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        http = desk.http
        await http.put("/maps/active", json={"id": split.id})
        smaller, larger = sorted((await http.get("/rooms")).json(), key=lambda room: room["area_m2"])
        await http.patch(f"/rooms/{smaller['id']}", json={"name": "Pantry"})
        await http.post("/rooms/merge", json={"rooms": [smaller["id"], larger["id"]]})
        parted = (await http.post("/rooms/split", json={"line": DRAWN.tolist()})).json()
        named = {room["name"]: room["area_m2"] for room in parted}
        assert len(named) == 2 and named["Pantry"] == smaller["area_m2"] < larger["area_m2"]


async def test_what_cannot_be_done_with_rooms_is_a_problem(tmp_path: Path) -> None:
    planned = store_planned_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        http = desk.http
        assert is_problem(await http.get("/rooms"), 409)
        await http.put("/maps/active", json={"id": planned.id})
        assert is_problem(await http.get("/rooms/none"), 404)
        assert is_problem(await http.patch("/rooms/none", json={"name": "Hall"}), 404)
        assert is_problem(await http.patch("/rooms/room-k", json={"name": "living ROOM"}), 409)
        assert is_problem(await http.patch("/rooms/room-k", json={"name": "\x1b"}), 422)
        assert is_problem(await http.post("/rooms/merge", json={"rooms": ["room-l"]}), 422)
        assert is_problem(await http.post("/rooms/merge", json={"rooms": ["room-l", "room-l"]}), 409)
        assert is_problem(await http.post("/rooms/split", json={"line": [[0, 0], [0, 1, 2]]}), 422)
        assert is_problem(await http.post("/rooms/split", json={"line": [[1.0, 0.0], [1.0, 0.01]]}), 409)
        assert is_problem(await http.delete("/doors/none"), 404)
        assert is_problem(await http.get("/floorplan", params={"format": "bmp"}), 422)
        assert [room["name"] for room in (await http.get("/rooms")).json()] == ["Living room", "Room 2"]
        assert (await http.delete("/doors/door-k")).status_code == 200  # nobody went through it: there may be none


async def test_a_map_without_a_plan_says_how_to_get_one(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        await desk.http.put("/maps/active", json={"id": place_map.id})
        answer = await desk.http.get("/floorplan")
        assert is_problem(answer, 409) and "build it again" in answer.json()["detail"]
        assert (await desk.http.get("/place/current")).json()["room"] is None
