"""A station whose data folder takes no writes: it starts, shows, localises, and refuses every change in a sentence."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sqlite3
import sys
from pathlib import Path

from station.files.navigation_folder import save_navigation
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.maps.store import MapStore
from tests.support.disk import fill, small_disk, unwritable
from tests.support.made_up_workers import made_up_navigation
from tests.support.station import running_station, store_map
from tests.support.station_at_work import at_work, is_problem, keep_navigation, wait_for
from tests.support.store import rename_place

NAMED = "Sofa"


def spoilt_station(data_dir: Path) -> str:
    """The data of a station that ended in the middle of everything; its map's id.

    A change of the map without its row, a drive that was being recorded, one that is ready, a deleted map.
    """
    place_map = store_map(data_dir)
    rename_place(MapStore(data_dir / "maps"), place_map.id, place_map.places[0].id, NAMED)
    with contextlib.closing(sqlite3.connect(data_dir / "maps" / "maps.db")) as connection:
        connection.execute("DELETE FROM map_version WHERE number = 2")
        connection.commit()
    library = NavigationLibrary(data_dir / "navigations")
    library.store(NavigationRecord("nav-1", "Ready", "ready", 1.0, "sfm", landmarks=5, scale="metric"))
    library.store(NavigationRecord("nav-2", "Cut", "recording", 2.0, "sfm"))
    save_navigation(made_up_navigation(), library.navigation_folder("nav-1"))
    (library.folder("nav-1") / "recording.mcap").write_bytes(b"x")
    return place_map.id


async def station_map(*arguments: str) -> tuple[int | None, str, str]:
    """A command, beside the running station."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "station.main", "map", *arguments,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    out, err = await process.communicate()
    return process.returncode, out.decode(), err.decode()


async def test_a_station_on_a_disk_that_takes_no_writes_shows_and_localises_and_changes_nothing(
    tmp_path: Path,
) -> None:
    map_id = spoilt_station(tmp_path)
    refused = "(Read-only file system)" if os.getuid() == 0 else "(Permission denied)"
    with unwritable(tmp_path):
        async with at_work(tmp_path) as (desk, _, _film):
            http = desk.http
            assert [m["id"] for m in (await http.get("/maps")).json()] == [map_id]
            states = {n["id"]: n["state"] for n in (await http.get("/navigations")).json()}
            assert states == {"nav-1": "ready", "nav-2": "failed"}
            assert (await http.put("/maps/active", json={"id": map_id})).status_code == 200
            await wait_for(desk, "/place/current", lambda answer: answer["state"] == "known")
            places = (await http.get("/places")).json()
            assert places[0]["name"] == NAMED
            for answer in (
                await http.post("/navigations", json={"name": "new"}),
                await http.patch("/navigations/nav-1", json={"name": "other"}),
                await http.delete("/navigations/nav-1"),
                await http.patch(f"/places/{places[0]['id']}", json={"name": "Desk"}),
                await http.patch(f"/maps/{map_id}", json={"name": "Flat"}),
                await http.post("/places/undo"),
            ):
                assert is_problem(answer, 409) and refused in answer.json()["detail"], answer.json()
            for call, body in (("/maps", {"navigations": ["nav-1"]}), ("/navigations/nav-1/reprocess", None)):
                job = (await http.post(call, json=body)).json()
                over = await wait_for(desk, f"/jobs/{job['id']}", lambda job: job["state"] != "running")
                assert over["state"] == "failed" and refused in over["message"]
            assert (await http.get("/places")).json() == places
            assert {n["id"]: n["name"] for n in (await http.get("/navigations")).json()}["nav-1"] == "Ready"
            log = [line["text"] for line in (await http.get("/log")).json()]
            assert sum("nothing can be recorded or changed" in text for text in log) == 1
            assert any("which map is in use will be forgotten" in text for text in log)
        code, out, err = await station_map("list", "--data", str(tmp_path))
        assert code == 0 and map_id in out and "can be seen, not changed" in err
        code, out, err = await station_map("verify", "--data", str(tmp_path))
        assert code == 0 and "all maps are as they were written" in out
        code, out, err = await station_map("delete", map_id, "--data", str(tmp_path))
        assert code == 1 and out == "" and refused in err and "Traceback" not in err
        assert str(tmp_path / "maps") in err.splitlines()[-1]
    async with running_station(1, tmp_path) as desk:  # it takes writes again
        assert (await desk.http.put("/maps/active", json={"id": map_id})).status_code == 200
        places = (await desk.http.get("/places")).json()
        renamed = await desk.http.patch(f"/places/{places[0]['id']}", json={"name": "Desk"})
        assert places[0]["name"] == NAMED and renamed.status_code == 200
        assert (await desk.http.patch("/navigations/nav-1", json={"name": "other"})).json()["name"] == "other"
    library = NavigationLibrary(tmp_path / "navigations")
    assert library.open() == [] and library.get("nav-1").name == "other"


async def test_a_full_disk_is_made_room_on_by_deleting_and_emptying_the_bin(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "32m") as disk:
        keep_navigation(disk, "nav-1")
        async with running_station(1, disk) as desk:
            fill(disk)
            assert (await desk.http.delete("/navigations/nav-1")).status_code == 204
            assert [entry["id"] for entry in (await desk.http.get("/bin")).json()] == ["nav-1"]
            log = [line["text"] for line in (await desk.http.get("/log")).json()]
            assert any("when something was deleted will be forgotten" in text for text in log)
            assert (await desk.http.post("/navigations/nav-1/restore")).status_code == 200
            assert (await desk.http.delete("/navigations/nav-1")).status_code == 204
            assert (await desk.http.delete("/bin")).status_code == 204
            assert (await desk.http.get("/bin")).json() == [] and not list((disk / "navigations" / ".bin").iterdir())
