"""What can be done with recorded navigations: bin, comparison, replay, SLAM once more, maps of several."""

from __future__ import annotations

import asyncio
import errno
import shutil
import socket
from contextlib import aclosing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import websockets

from shared.mcap_recording import recorded_pictures
from station.api.streams import HEADER
from station.demo.demo import Demo, DemoOptions, wait_for_slam
from station.demo.processes import Programs
from station.demo.simulator_client import SimulatorClient
from station.demo.station_client import StationClient
from station.files.unwritable import cannot_write
from station.library.bin import KEEP_S, Bin
from station.library.navigation_records import NavigationLibrary
from station.recordings.playback import replay
from tests.support.link import until
from tests.support.station import Desk, Film, running_station, store_map
from tests.support.station_at_work import at_work, is_problem, keep_navigation, wait_for
from tests.support.store import leave_old_blob


async def record(desk: Desk, film: Film, name: str, pictures: int = 8) -> str:
    """A navigation that is over, with its recording."""
    navigation = (await desk.http.post("/navigations", json={"name": name})).json()["id"]
    seen = film.count
    await until(lambda: film.count >= seen + pictures)
    await desk.http.post(f"/navigations/{navigation}/stop")
    await wait_for(desk, f"/navigations/{navigation}", lambda n: n["state"] in ("ready", "failed"))
    return str(navigation)


async def test_what_is_deleted_comes_back_also_after_a_restart(tmp_path: Path) -> None:
    navigation, place_map = keep_navigation(tmp_path, "nav-1"), store_map(tmp_path)
    async with running_station(1, tmp_path) as desk:
        http = desk.http
        assert (await http.delete(f"/navigations/{navigation.id}")).status_code == 204
        assert (await http.delete(f"/maps/{place_map.id}")).status_code == 204
        assert is_problem(await http.get(f"/navigations/{navigation.id}"), 404)
        assert (await http.get("/maps")).json() == []
    async with running_station(1, tmp_path) as desk:
        http = desk.http
        deleted = {entry["kind"]: entry for entry in (await http.get("/bin")).json()}
        assert deleted["navigation"]["name"] == navigation.name
        assert deleted["map"]["gone_unix_s"] == pytest.approx(deleted["map"]["deleted_unix_s"] + KEEP_S)
        assert (await http.post(f"/navigations/{navigation.id}/restore")).json()["state"] == "ready"
        assert (await http.post(f"/maps/{place_map.id}/restore")).json()["places"] == len(place_map.places)
        assert (await http.get("/bin")).json() == []
        assert is_problem(await http.post(f"/navigations/{navigation.id}/restore"), 404)
        assert is_problem(await http.post(f"/maps/{place_map.id}/restore"), 404)
        assert (await http.get(f"/navigations/{navigation.id}/trajectory.tum")).status_code == 200
        assert (await http.put("/maps/active", json={"id": place_map.id})).status_code == 200


async def test_an_emptied_bin_is_empty_on_the_disk(tmp_path: Path) -> None:
    navigation, place_map = keep_navigation(tmp_path, "nav-1"), store_map(tmp_path)
    async with running_station(1, tmp_path) as desk:
        await desk.http.delete(f"/navigations/{navigation.id}")
        await desk.http.delete(f"/maps/{place_map.id}")
        assert (await desk.http.delete("/bin")).status_code == 204
        assert (await desk.http.get("/bin")).json() == []
    assert not list((tmp_path / "navigations" / ".bin").iterdir())


async def test_a_station_that_starts_removes_what_a_killed_build_left(tmp_path: Path) -> None:
    place_map, left = store_map(tmp_path), leave_old_blob(tmp_path / "maps")
    async with running_station(1, tmp_path) as desk:
        await until(lambda: not left.exists())
        assert (await desk.http.put("/maps/active", json={"id": place_map.id})).status_code == 200


async def test_what_cannot_be_deleted_for_good_keeps_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as what another account has written: the rest of the bin goes, and what is deleted meanwhile is."""
    for number in (1, 2, 3):
        keep_navigation(tmp_path, f"nav-{number}")
    purge = NavigationLibrary.purge

    def purge_others(library: NavigationLibrary, navigation_id: str) -> None:
        if navigation_id == "nav-2":
            raise cannot_write(tmp_path, OSError(errno.EACCES, "Permission denied"))
        purge(library, navigation_id)

    monkeypatch.setattr(NavigationLibrary, "purge", purge_others)
    async with running_station(1, tmp_path) as desk:
        http = desk.http

        async def left() -> list[str]:
            return [entry["id"] for entry in (await http.get("/bin")).json()]

        for number in (1, 2):
            assert (await http.delete(f"/navigations/nav-{number}")).status_code == 204
        assert await left() == ["nav-2", "nav-1"]
        assert is_problem(await http.delete("/bin"), 409)
        assert await left() == ["nav-2"]
        monkeypatch.setattr(Bin, "due", Bin.list)
        assert (await http.delete("/navigations/nav-3")).status_code == 204
        assert await left() == ["nav-2"]
        log = [line["text"] for line in (await http.get("/log")).json()]
        assert any("could not be deleted for good" in text for text in log)


async def test_a_recording_is_played_again_at_its_own_pace(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, film):
        navigation = await record(desk, film, "Again", pictures=12)
        path = desk.station.navigations.library.folder(navigation) / "recording.mcap"
        recorded = list(recorded_pictures(path))
        async with websockets.connect(desk.socket(f"/ws/replay?navigation={navigation}&speed=16")) as socket:
            shown = []
            async for message in socket:
                assert isinstance(message, bytes)
                shown.append(HEADER.unpack(message[: HEADER.size]))
                await socket.send("next")
        assert shown[-1][0] == recorded[-1].number
        times = {picture.number: picture.t_robot_ns for picture in recorded}
        assert all(times[seq] == t_ns for seq, _, _, t_ns, *_ in shown)
        way = (await desk.http.get(f"/navigations/{navigation}/replay")).json()
        assert len(way["t_s"]) == len(way["T_world_cam"]) > 2
        assert way["t_s"][0] == 0 and np.all(np.diff(way["t_s"]) > 0)
        cloud = await desk.http.get(f"/navigations/{navigation}/landmarks")
        assert cloud.content[:4] == b"SLM1" and cloud.headers["X-Source"] == navigation
        async with desk.http.stream("GET", f"/navigations/{navigation}/replay.mjpg?speed=16") as stream:
            body = b"".join([part async for part in stream.aiter_bytes()])
        assert body.count(b"Content-Type: image/jpeg") >= 1
        async with aclosing(replay(path, from_s=recorded[-1].since_first_s, speed=16)) as pictures:
            assert [picture.number async for picture in pictures] == [recorded[-1].number]
        unreadable = keep_navigation(tmp_path, "nav-unreadable")
        desk.station.navigations.library.remember(unreadable)
        desk.station.navigations.library.recording(unreadable.id).write_bytes(b"no recording")
        refused = {"nowhere": (4404, "nowhere"), unreadable.id: (4409, unreadable.id)}
        for wanted, (code, words) in refused.items():
            async with websockets.connect(desk.socket(f"/ws/replay?navigation={wanted}")) as socket:
                await socket.wait_closed()
            assert socket.close_code == code and words in (socket.close_reason or "")


async def test_slam_runs_again_over_a_recording_whose_slam_crashed(tmp_path: Path) -> None:
    async with at_work(tmp_path, backend="tests.support.made_up_workers:FailingSlam") as (desk, _, film):
        navigation = await record(desk, film, "Crashed")
        assert (await desk.http.get(f"/navigations/{navigation}")).json()["state"] == "failed"
    async with running_station(1, tmp_path) as desk:  # with SLAM that works
        library = desk.station.navigations.library
        library.remember(replace(library.get(navigation), frames_skipped=3))  # and had been too slow before
        job = (await desk.http.post(f"/navigations/{navigation}/reprocess")).json()
        assert is_problem(await desk.http.post(f"/navigations/{navigation}/reprocess"), 409)
        assert is_problem(await desk.http.delete(f"/navigations/{navigation}"), 409)
        done = await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["state"] != "running")
        assert done["state"] == "done", done
        made = (await desk.http.get(f"/navigations/{navigation}")).json()
        assert made["state"] == "ready" and made["landmarks"] > 0 and made["frames_skipped"] == 0
        assert (await desk.http.get(f"/navigations/{navigation}/landmarks.ply")).status_code == 200
        assert (await desk.http.delete(f"/navigations/{navigation}")).status_code == 204


async def test_the_demo_runs_slam_again_where_it_left_out_most_pictures(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, film):
        navigation = await record(desk, film, "Busy")
        library = desk.station.navigations.library
        said: list[str] = []
        options = DemoOptions(seed=1, once=True, port=0, out=tmp_path, world="small", backend=None)
        with Programs(tmp_path / "logs") as programs, socket.create_server(("127.0.0.1", 0)) as nobody:
            port = nobody.getsockname()[1]
            simulator = SimulatorClient(port)
            demo = Demo(options, programs, StationClient(desk.address), simulator, port, said.append)
            for skipped in (1, 5):
                library.remember(replace(library.get(navigation), frames=8, frames_skipped=skipped))
                await asyncio.to_thread(wait_for_slam, demo, "Navigation1", navigation, is_for_map=True)
            simulator.close()
        assert len(said) == 3 and "8 frames, 1 of them left out by SLAM" in said[0]
        assert "5 of 8 pictures came too quickly" in said[1] and "8 frames, " in said[2] and "left out" not in said[2]
        assert library.get(navigation).frames_skipped == 0


async def test_two_drives_are_compared_and_mapped_together(tmp_path: Path) -> None:
    keep_navigation(tmp_path, "nav-1"), keep_navigation(tmp_path, "nav-2")
    async with running_station(1, tmp_path) as desk:
        http = desk.http
        job = (await http.post("/comparisons", json={"first": "nav-1", "second": "nav-2"})).json()
        mapping = (await http.post("/maps", json={"navigations": ["nav-1", "nav-2"], "name": "Both"})).json()
        done = await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["state"] != "running")
        assert done["state"] == "done", done
        (comparison,) = (await http.get("/comparisons")).json()
        assert comparison["id"] == done["result"]["comparison"]
        assert comparison["accepted"] and comparison["matches"] > 0
        np.testing.assert_allclose(np.reshape(comparison["T_first_second"], (4, 4)), np.eye(4), atol=0.05)
        report = await http.get(comparison["report"])
        assert "text/html" in report.headers["content-type"] and b'<img src="data:' in report.content
        numbers = (await http.get(f"/comparisons/{comparison['id']}/results.json")).json()
        assert numbers["places"] == comparison["places"]
        assert is_problem(await http.get(f"/comparisons/{comparison['id']}/figures"), 422)
        assert is_problem(await http.post("/comparisons", json={"first": "nav-1", "second": "nav-1"}), 409)
        built = await wait_for(desk, f"/jobs/{mapping['id']}", lambda j: j["state"] != "running")
        assert built["state"] == "done", built
        assert (await http.get("/maps")).json()[0]["name"] == "Both"
        assert (await http.delete(f"/comparisons/{comparison['id']}")).status_code == 204
        assert (await http.get("/comparisons")).json() == []


async def test_a_cancelled_comparison_leaves_nothing(tmp_path: Path) -> None:
    keep_navigation(tmp_path, "nav-1"), keep_navigation(tmp_path, "nav-2")
    async with running_station(1, tmp_path) as desk:
        job = (await desk.http.post("/comparisons", json={"first": "nav-1", "second": "nav-2"})).json()
        await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["progress"] > 0)
        assert (await desk.http.delete(f"/jobs/{job['id']}")).json()["state"] == "cancelled"
        assert (await desk.http.get("/comparisons")).json() == []
    assert not list((tmp_path / "comparisons").iterdir())


async def test_a_map_of_drives_that_do_not_fit_says_which(tmp_path: Path) -> None:
    keep_navigation(tmp_path, "nav-1"), keep_navigation(tmp_path, "nav-2")
    broken = tmp_path / "navigations" / "nav-2" / "navigation"
    shutil.rmtree(broken)
    async with running_station(1, tmp_path) as desk:
        job = (await desk.http.post("/maps", json={"navigations": ["nav-1", "nav-2"]})).json()
        done = await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["state"] != "running")
        assert done["state"] == "failed" and "nav-2" in done["message"]


async def test_a_map_is_in_use_while_plates_are_read_and_that_can_be_cancelled(tmp_path: Path) -> None:
    keep_navigation(tmp_path, "nav-1")
    async with running_station(1, tmp_path) as desk:
        job = (await desk.http.post("/maps", json={"navigations": ["nav-1"]})).json()
        await wait_for(desk, f"/jobs/{job['id']}", lambda j: "door plates" in j["message"])
        (made,) = (await desk.http.get("/maps")).json()
        assert made["first"]
        assert (await desk.http.delete(f"/jobs/{job['id']}")).json()["state"] == "cancelled"
        assert (await desk.http.get("/maps")).json() == [made]
