"""What callers are told: refusals with their remedy, new names, clouds as files, colours that stay."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import websockets

from station.maps.store import MapStore
from station.places.making.repeatability import repeatability
from tests.support.station import DRAWN, running_station, store_map, store_split_map
from tests.support.station_at_work import at_work, is_problem, keep_navigation, wait_for


async def test_a_hijack_is_answered_by_what_the_robot_made_of_it(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        nowhere = await desk.http.post("/robot/hijack", json={"x": 99.0, "y": 0.0})
        assert is_problem(nowhere, 422) and "not free floor" in nowhere.json()["detail"]
        assert is_problem(await desk.http.post("/robot/hijack", json={"x": 1.0}), 422)
        assert not bench.head.moved
        assert (await desk.http.post("/robot/hijack")).json() == {"ok": True}  # wherever the robot likes
        assert bench.head.moved == [(3.0, 4.0, 0.0)]
    async with running_station(1, tmp_path) as desk:
        assert is_problem(await desk.http.post("/robot/hijack"), 503)


MISTAKES: dict[str, tuple[dict[str, Any], str]] = {
    "no content type": ({"content": '{"linear": 0.1, "angular": 0}'}, "Content-Type: application/json"),
    "no JSON": ({"content": '{"linear": 0.1,', "headers": {"Content-Type": "application/json"}}, "is no JSON"),
    "nested without end": (
        {"content": "[" * 50_000, "headers": {"Content-Type": "application/json"}},
        "nests too deep",
    ),
    "an endless number": (
        {"content": '{"linear": ' + "9" * 5000 + "}", "headers": {"Content-Type": "application/json"}},
        "too many digits",
    ),
    "a list": ({"json": [1]}, "must be a JSON object"),
    "nothing": ({}, "a JSON body is needed"),
    "a field too many": ({"json": {"linear": 0.1, "angular": 0, "speed": 1}}, "known are linear, angular, ttl_ms"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
async def test_mistakes_in_a_body_are_named_with_their_remedy(tmp_path: Path, mistake: str) -> None:
    request, words = MISTAKES[mistake]
    async with running_station(1, tmp_path) as desk:
        answer = await desk.http.request("POST", "/drive", **request)
        assert is_problem(answer, 422) and words in answer.json()["detail"], answer.text


async def test_a_body_that_is_no_text_is_a_bad_request_and_says_why(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        answer = await desk.http.post(
            "/drive", content=b'{"linear": "\xff"}', headers={"Content-Type": "application/json"}
        )
        assert is_problem(answer, 400) and "no text in UTF-8" in answer.json()["detail"]


async def test_a_change_of_nothing_and_a_replay_of_nothing_are_refused(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with at_work(tmp_path) as (desk, _, _):
        await desk.http.put("/maps/active", json={"id": place_map.id})
        nothing = await desk.http.patch(f"/places/{place_map.places[0].id}", json={})
        assert is_problem(nothing, 422) and "give name or hidden" in nothing.json()["detail"]
        drive = (await desk.http.post("/navigations")).json()["id"]
        await wait_for(desk, f"/navigations/{drive}", lambda d: d["frames"] > 5)
        await desk.http.post(f"/navigations/{drive}/stop")
        await wait_for(desk, f"/navigations/{drive}", lambda d: d["state"] == "ready")
        beyond = await desk.http.get(f"/navigations/{drive}/replay.mjpg?from_s=9999")
        assert is_problem(beyond, 422) and "after the last picture" in beyond.json()["detail"]
        async with websockets.connect(desk.socket(f"/ws/replay?navigation={drive}&from_s=9999")) as socket:
            await socket.wait_closed()
            assert socket.close_code == 4422 and "after the last picture" in (socket.close_reason or "")


async def test_drives_and_maps_are_renamed_and_their_clouds_are_ply_files(tmp_path: Path) -> None:
    place_map, drive = store_map(tmp_path), keep_navigation(tmp_path, "nav-1")
    async with running_station(1, tmp_path) as desk:
        empty = await desk.http.get("/landmarks?format=ply")
        assert is_problem(empty, 409) and "/navigations/ID" in empty.json()["detail"]
        await desk.http.put("/maps/active", json={"id": place_map.id})
        assert place_map.id in (await desk.http.get("/landmarks?format=ply")).json()["detail"]
        for path in (f"/maps/{place_map.id}", f"/navigations/{drive.id}"):
            ply = await desk.http.get(f"{path}/landmarks?format=ply")
            assert f"element vertex {len(place_map.navigation.landmarks)}".encode() in ply.content
            assert (await desk.http.patch(path, json={"name": "  Ground  floor "})).json()["name"] == "Ground floor"
            for blank in ("", "   "):
                refused = await desk.http.patch(path, json={"name": blank})
                assert is_problem(refused, 422) and "needs a character" in refused.json()["detail"]
            for forged in ("Flat\x00", "\x1b[2J", "Flat\nrobot lost"):
                refused = await desk.http.patch(path, json={"name": forged})
                assert is_problem(refused, 422) and "cannot be shown" in refused.json()["detail"]
            for unseen in ("Flat\u200b", "\u2060", "\u3164", "\ufeffFlat", "\u200d"):
                refused = await desk.http.patch(path, json={"name": unseen})
                assert is_problem(refused, 422) and "cannot be seen" in refused.json()["detail"]
            assert is_problem(await desk.http.patch(f"{path}-not", json={"name": "x"}), 404)
        assert (await desk.http.get("/graph")).json()["metric"] is True
    async with running_station(1, tmp_path) as desk:
        names = [(await desk.http.get(path)).json()[0]["name"] for path in ("/maps", "/navigations")]
        assert names == ["Ground floor", "Ground floor"]


async def test_an_answer_of_the_api_has_an_icon_and_the_documentation_a_version(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        for path in ("/favicon.ico", "/favicon.svg"):  # browsers ask for the first beside whatever names none
            icon = await desk.http.get(path)
            assert icon.status_code == 200 and icon.headers["content-type"].startswith("image/svg")
        assert re.fullmatch(r"\d+\.\d+.*", (await desk.http.get("/openapi.json")).json()["info"]["version"])


async def test_undoing_a_change_of_places_leaves_the_maps_name(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    path = f"/places/{place_map.places[0].id}"
    async with running_station(1, tmp_path) as desk:
        await desk.http.put("/maps/active", json={"id": place_map.id})
        await desk.http.patch(path, json={"name": "Kitchen"})
        await desk.http.patch(f"/maps/{place_map.id}", json={"name": "Ground floor"})
        await desk.http.patch(path, json={"name": "Scullery"})
        await desk.http.patch(f"/maps/{place_map.id}", json={"name": "Upstairs"})
        changes = (await desk.http.get("/places/changes")).json()
        assert [change["why"] for change in changes] == [
            "Kitchen is Scullery now", f"{place_map.places[0].name} is Kitchen now"]  # fmt: skip
        for wanted, words in ((99, "no change of the places"), (changes[1]["version"], "another change came after")):
            refused = await desk.http.post("/places/undo", json={"version": wanted})
            assert is_problem(refused, 409) and words in refused.json()["detail"]
        for change, name in zip(changes, ("Kitchen", place_map.places[0].name), strict=True):
            undone = await desk.http.post("/places/undo", json={"version": change["version"]})
            assert undone.json()["why"] == change["why"]
            assert (await desk.http.get(path)).json()["name"] == name
            assert [m["name"] for m in (await desk.http.get("/maps")).json()] == ["Upstairs"]
        assert is_problem(await desk.http.post("/places/undo"), 409)
    assert MapStore(tmp_path / "maps").load(place_map.id).name == "Upstairs"


async def test_an_undo_belongs_to_the_map_that_was_changed(tmp_path: Path) -> None:
    """Of two maps the newest change may have the same version."""
    one = store_map(tmp_path)
    other = replace(one, id=f"{one.id}-2")
    MapStore(tmp_path / "maps").save(other)
    made = []
    async with running_station(1, tmp_path) as desk:
        for place_map in (one, other):
            await desk.http.put("/maps/active", json={"id": place_map.id})
            await desk.http.patch(f"/places/{place_map.places[0].id}", json={"name": "Kitchen"})
            made += (await desk.http.get("/places/changes")).json()
        assert [change["map"] for change in made] == [one.id, other.id]
        assert made[0]["version"] == made[1]["version"]
        order = {"version": made[0]["version"], "map": one.id}
        refused = await desk.http.post("/places/undo", json=order)
        assert is_problem(refused, 409) and f"the change is of '{one.id}'" in refused.json()["detail"]
        assert (await desk.http.get("/places/changes")).json() == made[1:]
        await desk.http.put("/maps/active", json={"id": one.id})
        assert (await desk.http.post("/places/undo", json=order)).json() == made[0]


async def test_every_edit_answers_its_version_for_an_undo_of_just_that(tmp_path: Path) -> None:
    split = store_split_map(tmp_path)
    place, other = (place.id for place in split.places[:2])
    async with running_station(1, tmp_path) as desk:
        http = desk.http
        await http.put("/maps/active", json={"id": split.id})
        first, second = (room["id"] for room in (await http.get("/rooms")).json())

        async def newest_after(method: str, path: str, body: object = None) -> dict[str, Any]:
            answer = await http.request(method, path, json=body)
            newest: dict[str, Any] = (await http.get("/places/changes")).json()[0]
            assert answer.headers["X-Change-Version"] == str(newest["version"]), path
            return newest

        await newest_after("PATCH", f"/places/{place}", {"name": "Sofa"})
        await newest_after("PATCH", f"/places/{place}", {"hidden": True})
        await newest_after("POST", "/places/merge", {"places": [place, other]})
        await newest_after("PATCH", f"/rooms/{first}", {"name": "Hall"})
        await newest_after("PATCH", f"/rooms/{first}", {"name": None})
        await newest_after("POST", "/rooms/merge", {"rooms": [first, second]})
        before = await newest_after("POST", "/rooms/split", {"line": DRAWN.tolist()})
        (door,) = (await http.get("/floorplan")).json()["doors"]
        newest = await newest_after("DELETE", f"/doors/{door['id']}")
        refused = await http.post("/places/undo", json={"version": before["version"]})
        assert is_problem(refused, 409) and newest["why"] in refused.json()["detail"]
        undone = await http.post("/places/undo", json={"version": newest["version"]})
        assert undone.json() == newest


async def test_an_edit_that_changes_nothing_answers_no_version(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    path = f"/places/{place_map.places[0].id}"
    async with running_station(1, tmp_path) as desk:
        await desk.http.put("/maps/active", json={"id": place_map.id})
        assert "X-Change-Version" in (await desk.http.patch(path, json={"name": "Sofa"})).headers
        for same in ({"name": "Sofa"}, {"hidden": False}):
            assert "X-Change-Version" not in (await desk.http.patch(path, json=same)).headers


async def test_the_way_from_one_place_to_another_is_told_by_name(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    first, *_, last = place_map.places
    async with running_station(1, tmp_path) as desk:
        await desk.http.put("/maps/active", json={"id": place_map.id})
        await desk.http.patch(f"/places/{last.id}", json={"name": "Sofa"})
        route = (await desk.http.get("/graph/route", params={"start": first.id, "goal": "sofa"})).json()
        assert route["places"][0] == {"id": first.id, "name": first.name}
        assert route["places"][-1] == {"id": last.id, "name": "Sofa"}
        ends = [place["id"] for place in route["places"]]
        assert [(leg["a"], leg["b"]) for leg in route["legs"]] == list(itertools.pairwise(ends))
        assert route["length"] == pytest.approx(sum(leg["distance"] for leg in route["legs"])) and route["metric"]
        for query in ({"start": first.id}, {"start": "", "goal": last.id}):
            assert is_problem(await desk.http.get("/graph/route", params=query), 422)
        nowhere = await desk.http.get("/graph/route", params={"start": first.id, "goal": "Garage"})
        assert is_problem(nowhere, 404) and "Garage" in nowhere.json()["detail"]


async def test_how_surely_places_would_be_found_again_is_measured_in_the_background(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with running_station(1, tmp_path) as desk:
        assert is_problem(await desk.http.post("/places/repeatability"), 409)  # no map is in use
        await desk.http.put("/maps/active", json={"id": place_map.id})
        begun = await desk.http.post("/places/repeatability")
        assert begun.status_code == 202
        job = await wait_for(desk, f"/jobs/{begun.json()['id']}", lambda job: job["state"] != "running")
        assert job["state"] == "done", job
        assert job["result"] == pytest.approx(
            dict(zip((p.id for p in place_map.places), repeatability(place_map).tolist(), strict=True))
        )


async def test_a_merge_leaves_the_other_places_their_colours(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with running_station(1, tmp_path) as desk:
        await desk.http.put("/maps/active", json={"id": place_map.id})

        async def colours() -> dict[str, int]:
            return {place["id"]: place["colour"] for place in (await desk.http.get("/places")).json()}

        before = await colours()
        first, second = place_map.places[:2]
        await desk.http.post("/places/merge", json={"places": [first.id, second.id]})
        assert await colours() == {name: colour for name, colour in before.items() if name != second.id}
        await desk.http.post("/places/undo")
        assert await colours() == before
