"""The whole station over real sockets: robot-server with pushed devices, made-up estimation, HTTP and WebSockets."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import struct
import sys
from pathlib import Path
from typing import Any

import pytest
import websockets

from shared.disk import SCRATCH
from shared.listening import bind
from station.model.map_store import StoreAddress
from station.workers.jobs import JobWorker
from station.workers.library_interface import LibraryProgram
from tests.support.link import until
from tests.support.paths import ROOT
from tests.support.station import running_station, store_map
from tests.support.station_at_work import at_work, is_problem, wait_for


async def test_every_error_is_a_problem_document(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        http = desk.http
        assert is_problem(await http.get("/nothing"), 404)
        assert is_problem(await http.delete("/robot"), 405)
        assert is_problem(await http.post("/drive", json={"linear": "fast", "angular": 0}), 422)
        assert is_problem(await http.post("/drive", json={"linear": 0.1, "angular": 0}), 503)
        assert is_problem(await http.post("/drive", json={"linear": 0.1, "angular": 0, "ttl_ms": 0}), 422)
        assert is_problem(await http.post("/drive", content=b'{"linear": NaN, "angular": 0}'), 422)
        assert is_problem(await http.post("/stop"), 503)
        assert is_problem(await http.get("/camera/frame.jpg"), 503)
        assert is_problem(await http.get("/camera/stream.mjpg"), 503)
        assert is_problem(await http.get("/places"), 409)
        assert is_problem(await http.get("/graph"), 409)
        assert is_problem(await http.get("/graph/route?start=a&goal=b"), 409)
        assert is_problem(await http.put("/maps/active", json={"id": "none"}), 404)
        assert is_problem(await http.delete("/maps/none"), 404)
        assert is_problem(await http.post("/maps", json={"navigations": ["none"]}), 404)
        assert is_problem(await http.post("/maps", json={"navigations": []}), 422)
        assert is_problem(await http.post("/navigations"), 503)
        assert is_problem(await http.post("/navigations/none/stop"), 404)
        assert is_problem(await http.get("/jobs/none"), 404)
        assert is_problem(await http.post("/robot/hijack", json={"x": 0, "y": 0, "yaw": 0}), 503)
        assert is_problem(await http.get("/robot", headers={"Origin": "http://elsewhere.example"}), 403)


async def test_what_was_asked_at_length_is_answered_in_short(tmp_path: Path) -> None:
    long, kind = "n" * 20_000, {"Content-Type": "application/json"}
    store_map(tmp_path)
    async with running_station(1, tmp_path) as desk:
        http = desk.http
        map_id = (await http.get("/maps")).json()[0]["id"]
        assert (await http.put("/maps/active", json={"id": map_id})).status_code == 200
        for answer in (
            await http.get(f"/navigations/{long}"),
            await http.get(f"/robots/{long}/robot"),
            await http.get(f"/jobs/{long}"),
            await http.get(f"/{long}"),
            await http.delete(f"/maps/{long}"),
            await http.delete(f"/robot/{long}"),
            await http.get(f"/graph/route?start={long}&goal={long}"),
            await http.patch(f"/rooms/{long}", json={"name": "Kitchen"}),
            await http.patch(f"/places/{long}", json={"name": "Kitchen"}),
            await http.put("/maps/active", json={"id": long}),
            await http.post("/places/merge", json={"places": [], long: 0}),
            await http.post("/places/merge", content="x", headers={"Content-Type": long}),
            await http.get("/places", headers={"Host": long}),
        ):
            assert 400 <= answer.status_code < 500 and len(answer.json()["detail"]) < 400, answer.request.url.path[:30]
        many = {f"k{number}": 0 for number in range(5000)}
        answer = await http.post("/places/merge", content=json.dumps(many), headers=kind)
        assert answer.status_code == 422 and len(answer.content) < 5000


async def test_a_station_without_robot_and_map_answers_all_it_can(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        place = (await desk.http.get("/place/current")).json()
        assert (place["state"], place["place"], place["probability"], place["map"]) == ("unknown", None, 0.0, None)
        assert not (await desk.http.get("/robot")).json()["connected"]
        assert (await desk.http.get("/maps")).json() == []
        assert (await desk.http.get("/navigations")).json() == []
        assert (await desk.http.get("/pose")).json()["state"] == "none"
        assert (await desk.http.get("/trajectory")).json()["p_world"] == []
        cloud = (await desk.http.get("/landmarks")).content
        assert struct.unpack("<4sIII", cloud) == (b"SLM1", 0, 0, 0)
        assert (await desk.http.get("/healthz")).json()["status"] == "ok"
        assert "sentinel_robot_connected 0.0" in (await desk.http.get("/metrics")).text


async def test_documents_name_no_other_host_and_show_every_call(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        document = (await desk.http.get("/openapi.json")).json()
        docs = (await desk.http.get("/docs")).text
    calls = {f"{method.upper()} {path}" for path, methods in document["paths"].items() for method in methods}
    assert {
        "GET /place/current", "GET /places", "GET /places/{place_id}", "PATCH /places/{place_id}",
        "GET /places/{place_id}/images/{kind}", "GET /graph", "GET /graph/route", "GET /maps", "POST /maps",
        "PUT /maps/active", "DELETE /maps/{map_id}", "POST /navigations", "POST /navigations/{navigation_id}/stop",
        "GET /navigations", "GET /pose", "GET /trajectory", "GET /landmarks", "GET /robot", "POST /drive",
        "POST /stop", "POST /pan-tilt", "GET /camera/frame.jpg", "GET /camera/stream.mjpg", "GET /healthz",
        "GET /metrics",
    } <= calls  # fmt: skip
    assert "Problem" in document["components"]["schemas"]
    assert "//" not in docs.replace("<!doctype", "").replace("</", "")


async def test_pages_of_other_sites_get_no_socket(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        with pytest.raises(websockets.InvalidStatus):
            await websockets.connect(desk.socket("/ws/drive"), origin=websockets.Origin("http://elsewhere.example"))


async def test_video_reaches_a_viewer_and_a_stuck_one_slows_nobody(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, film):
        url = desk.socket("/ws/camera")
        async with websockets.connect(url) as stuck, websockets.connect(url) as viewer:
            await stuck.recv()  # never acknowledged: it gets no second one
            seen: list[int] = []
            while len(seen) < 15:
                data = await viewer.recv()
                seq, width, height, _, age_s, _, _ = struct.unpack_from("<IHHqdII", data)
                assert (width, height) == (640, 480) and data[32:34] == b"\xff\xd8" and age_s >= 0
                seen.append(seq)
                await viewer.send("next")
            assert seen == sorted(set(seen))
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.2):
                    await stuck.recv()
            await stuck.send("next")
            newest = struct.unpack_from("<I", await stuck.recv())[0]
            assert newest >= seen[-1]  # the newest, not the second
        frame = await desk.http.get("/camera/frame.jpg")
        assert frame.content[:2] == b"\xff\xd8" and float(frame.headers["x-age-s"]) >= 0
        async with desk.http.stream("GET", "/camera/stream.mjpg") as stream:
            received = b""
            async for chunk in stream.aiter_raw():
                received += chunk
                if received.count(b"--sentinel-frame") >= 3:
                    break
        assert film.count > 15


async def test_record_build_ask_and_rename(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, _film):
        http = desk.http
        started = await http.post("/navigations", json={"name": "first drive"})
        assert started.status_code == 201 and started.json()["state"] == "recording"
        drive = f"/navigations/{started.json()['id']}"
        assert is_problem(await http.post("/navigations"), 409)
        pose = await wait_for(desk, "/pose", lambda p: p["T_world_body"] and p["frames"] > 5)
        assert pose["state"] == "tracking" and pose["message"] == "going straight"
        cloud = (await http.get("/landmarks")).content
        count, first, total = struct.unpack_from("<III", cloud, 4)
        assert first == 0 and count == total >= 50 and len(cloud) == 16 + 16 * count
        more = (await http.get(f"/landmarks?since={total}")).content
        assert struct.unpack_from("<I", more, 8)[0] == total
        source = (await http.get("/landmarks")).headers["x-source"]
        ply = await http.get("/landmarks", headers={"Accept": "application/x-ply"})
        assert ply.content.startswith(b"ply\nformat binary_little_endian 1.0\n")
        assert len((await http.get("/trajectory")).json()["p_world"]) > 5
        running = (await http.get(drive)).json()
        assert running["frames"] > 5 and running["imu_samples"] > 0

        assert (await http.post(f"{drive}/stop")).json()["state"] == "finishing"
        assert is_problem(await http.post(f"{drive}/stop"), 409)
        ready = await wait_for(desk, drive, lambda d: d["state"] != "finishing")
        replaced = await http.get(f"/landmarks?since={total}&navigation={source}")
        assert replaced.headers["x-source"] not in ("", source)  # the finished cloud is another one: all of it comes
        assert struct.unpack_from("<III", replaced.content, 4) == (ready["landmarks"], 0, ready["landmarks"])
        assert (await http.get("/trajectory")).json()["source"] == replaced.headers["x-source"]
        assert ready["state"] == "ready" and ready["scale"] == "metric" and ready["landmarks"] > 100
        assert (await http.get(f"{drive}/recording.mcap")).content.startswith(b"\x89MCAP")
        assert len((await http.get(f"{drive}/trajectory.tum")).text.splitlines()) > 10

        job = (await http.post("/maps", json={"navigations": [ready["id"]], "name": "Flat"})).json()
        done = await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["state"] != "running")
        assert done["state"] == "done" and done["result"]["places"] > 1
        [entry] = (await http.get("/maps")).json()
        assert entry["active"] and entry["name"] == "Flat" and entry["id"] == done["result"]["map"]

        places = (await http.get("/places")).json()
        answer = await wait_for(desk, "/place/current", lambda p: p["state"] == "known")
        assert answer["place"] == {"id": places[0]["id"], "name": places[0]["name"]}
        assert answer["probability"] == 0.9 and answer["distance_m"] == 0.5 and answer["age_s"] >= 0
        for path in (answer["evidence"]["query_image"], answer["evidence"]["map_image"]):
            assert (await http.get(path)).content[:2] == b"\xff\xd8"
        for kind in ("representative", "mean", "deviation"):
            assert (await http.get(f"/places/{places[0]['id']}/images/{kind}")).content[:2] == b"\xff\xd8"
        assert len((await http.get(f"/maps/{entry['id']}/landmarks")).content) == 16 + 16 * ready["landmarks"]
        graph = (await http.get("/graph")).json()
        assert len(graph["nodes"]) == len(places) and graph["edges"]
        assert "<graphml" in (await http.get("/graph?format=graphml")).text

        place = f"/places/{places[0]['id']}"
        assert is_problem(await http.patch(place, json={"name": places[1]["name"]}), 409)
        assert is_problem(await http.patch(place, json={"name": ""}), 422)
        assert (await http.patch(place, json={"name": "Sofa"})).json()["name"] == "Sofa"
        await wait_for(desk, "/place/current", lambda p: p["place"]["name"] == "Sofa")
        assert is_problem(await http.delete(f"/maps/{entry['id']}"), 409)
        assert (await http.put("/maps/active", json={"id": None})).json() is None
        assert (await http.delete(f"/maps/{entry['id']}")).status_code == 204
        assert (await http.delete(drive)).status_code == 204


async def test_places_are_hidden_shown_and_merged_and_that_outlives_the_station(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    first, second, third = place_map.places[:3]
    async with at_work(tmp_path) as (desk, _, _):
        http = desk.http
        await http.put("/maps/active", json={"id": place_map.id})
        await wait_for(desk, "/place/current", lambda a: a["place"] and a["place"]["id"] == first.id)
        await http.patch(f"/places/{first.id}", json={"name": "Sofa", "hidden": True})
        await wait_for(desk, "/place/current", lambda a: a["place"] and a["place"]["id"] == second.id)
        graph = (await http.get("/graph")).json()
        assert first.id not in {node["id"] for node in graph["nodes"]}
        assert first.id not in (await http.get("/graph?format=graphml")).text
        assert {p["id"]: p["hidden"] for p in (await http.get("/places")).json()}[first.id]
        assert is_problem(await http.get(f"/graph/route?start={second.id}&goal=Sofa"), 404)  # nobody is led there
        merged = (await http.post("/places/merge", json={"places": [second.id, third.id]})).json()
        assert (merged["id"], merged["name"]) == (second.id, second.name)
        assert merged["landmarks"] == len(second.landmark_index) + len(third.landmark_index)
        assert is_problem(await http.get(f"/places/{third.id}"), 404)
        assert is_problem(await http.post("/places/merge", json={"places": [second.id, "x"]}), 404)
        assert is_problem(await http.post("/places/merge", json={"places": [second.id, second.id]}), 409)
        assert is_problem(await http.post("/places/merge", json={"places": [second.id]}), 422)
    async with at_work(tmp_path) as (desk, _, _):
        places = {p["id"]: p for p in (await desk.http.get("/places")).json()}
        assert (places[first.id]["name"], places[first.id]["hidden"]) == ("Sofa", True)
        assert third.id not in places
        await desk.http.patch(f"/places/{first.id}", json={"hidden": False})
        await wait_for(desk, "/place/current", lambda a: a["place"] and a["place"]["name"] == "Sofa")


async def test_what_was_made_of_places_is_taken_back_one_after_the_other(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    first, second, third = place_map.places[:3]
    async with at_work(tmp_path) as (desk, _, _):
        http = desk.http
        assert is_problem(await http.post("/places/undo"), 409)  # no map is active
        await http.put("/maps/active", json={"id": place_map.id})
        assert (await http.get("/places/changes")).json() == []
        assert is_problem(await http.post("/places/undo"), 409)  # there is nothing to take back
        await http.patch(f"/places/{first.id}", json={"name": "Sofa"})
        await http.post("/places/merge", json={"places": [first.id, second.id]})
        merge, rename = (await http.get("/places/changes")).json()
        assert (merge["why"], rename["why"]) == (f"Sofa and {second.name} are one", f"{first.name} is Sofa now")
        await http.patch(f"/places/{third.id}", json={"hidden": True})
        # Another change came since the page offered to take the merge back.
        assert is_problem(await http.post("/places/undo", json={"version": merge["version"]}), 409)
        await http.post("/places/undo")
        assert (await http.post("/places/undo", json={"version": merge["version"]})).json() == merge
        places = {p["id"]: p for p in (await http.get("/places")).json()}
        assert (places[first.id]["name"], places[third.id]["hidden"]) == ("Sofa", False)
        assert places[second.id]["landmarks"] == len(second.landmark_index)
        await wait_for(desk, "/place/current", lambda a: a["place"] and a["place"]["name"] == "Sofa")
        assert (await http.get("/places/changes")).json() == [rename]
        await http.post("/places/undo")
        assert is_problem(await http.post("/places/undo"), 409)  # as it was made: the map itself stays
        assert [(p["id"], p["name"]) for p in (await http.get("/places")).json()] == [
            (p.id, p.name) for p in place_map.places
        ]
        assert "taken back" in (await http.get("/log")).text


async def test_the_active_map_is_still_active_after_a_restart(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with running_station(1, tmp_path) as desk:
        await desk.http.put("/maps/active", json={"id": place_map.id})
    async with running_station(1, tmp_path) as desk:
        assert (await desk.http.get("/place/current")).json()["map"] == place_map.id
        assert len((await desk.http.get("/places")).json()) == len(place_map.places)


async def test_what_a_killed_station_left_half_written_is_removed_at_the_next_start(tmp_path: Path) -> None:
    left = [
        tmp_path / part / f"{SCRATCH}0123456789abcdef" for part in ("access", "maps/blobs/ab", "calibrations/cal-1")
    ]
    for path in left:
        path.parent.mkdir(parents=True)
        path.write_bytes(b"half")
    async with running_station(1, tmp_path):
        await until(lambda: not any(path.exists() for path in left))


async def test_a_drive_too_short_to_map_says_so(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, film):
        film.pause()
        drive = (await desk.http.post("/navigations")).json()
        await desk.http.post(f"/navigations/{drive['id']}/stop")
        over = await wait_for(desk, f"/navigations/{drive['id']}", lambda d: d["state"] != "finishing")
        assert over["state"] == "failed" and "drive longer" in over["message"]
        assert is_problem(await desk.http.post("/maps", json={"navigations": [drive["id"]]}), 409)


async def test_a_dead_slam_worker_is_announced_and_the_recording_goes_on(tmp_path: Path) -> None:
    async with at_work(tmp_path, backend="tests.support.made_up_workers:DyingSlam") as (desk, _, _film):
        drive = (await desk.http.post("/navigations")).json()
        lines = await wait_for(desk, "/log", lambda log: sum("unexpectedly" in line["text"] for line in log) > 1)
        assert sum(line["level"] == "error" and "started again" in line["text"] for line in lines) > 1
        before = (await desk.http.get(f"/navigations/{drive['id']}")).json()["frames"]
        await wait_for(desk, f"/navigations/{drive['id']}", lambda d: d["frames"] > before + 5)
        await desk.http.post(f"/navigations/{drive['id']}/stop")
        await wait_for(desk, f"/navigations/{drive['id']}", lambda d: d["state"] in ("ready", "failed"))
        assert not [process for process in multiprocessing.active_children() if "SLAM" in process.name]


async def test_events_tell_the_state_first_and_then_each_change(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with at_work(tmp_path) as (desk, bench, _), websockets.connect(desk.socket("/ws/events")) as socket:
        kinds: set[str] = set()
        place: dict[str, Any] = {}
        await desk.http.put("/maps/active", json={"id": place_map.id})
        await desk.http.post("/drive", json={"linear": 0.1, "angular": 0.0}, headers={"X-Driver": "anna"})
        await desk.http.post("/navigations")
        while not {"robot", "driver", "map", "place", "log", "navigation", "pose", "landmarks"} <= kinds or (
            place.get("state") != "known"
        ):
            message = json.loads(await socket.recv())
            kinds.add(message["type"])
            place = message.get("place", place)
        await desk.http.post("/robot/hijack", json={"x": 1.0, "y": 2.0, "yaw": 0.5})
        await until(lambda: bench.head.moved == [(1.0, 2.0, 0.5)])
        while True:
            message = json.loads(await socket.recv())
            if message["type"] == "log" and message["line"]["topic"] == "hijack":
                break
        assert len((await desk.http.get("/place/timeline")).json()) >= 1


async def test_a_robot_that_goes_takes_the_current_place_with_it(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with at_work(tmp_path) as (desk, bench, _):
        await desk.http.put("/maps/active", json={"id": place_map.id})
        drive = (await desk.http.post("/navigations")).json()
        await wait_for(desk, "/place/current", lambda p: p["state"] == "known")
        await bench.stop()
        lost = await wait_for(desk, "/place/current", lambda p: p["state"] != "known")
        assert (lost["state"], lost["place"]) == ("lost", None) and "not connected" in lost["reason"]
        assert "sentinel_place_known 0.0" in (await desk.http.get("/metrics")).text
        assert (await desk.http.get("/robot")).json()["rates"] == {"frames_hz": 0, "imu_hz": 0, "bytes_per_s": 0}
        await bench.start()  # another run: other numbers, perhaps another clock
        over = await wait_for(desk, f"/navigations/{drive['id']}", lambda d: d["state"] in ("ready", "failed"))
        assert "started anew" in over["message"]
        assert (await desk.http.get(over["recording"])).content.startswith(b"\x89MCAP")
        await wait_for(desk, "/place/current", lambda p: p["state"] == "known")


async def test_a_running_job_can_be_cancelled(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        # Cancelled while its process starts: it would fail later, without a map to measure.
        async def work(worker: JobWorker[LibraryProgram]) -> dict[str, float]:
            return await worker.call(LibraryProgram.measure_places, StoreAddress(tmp_path), "none")

        job = desk.station.jobs.start("test", "places of nothing", work)
        cancelled = (await desk.http.delete(f"/jobs/{job.id}")).json()
        assert cancelled["state"] == "cancelled"


def test_a_port_in_use_is_one_sentence() -> None:
    from shared.errors import ConfigError

    with bind("127.0.0.1", 0) as taken, pytest.raises(ConfigError, match="choose another with --port"):
        bind("127.0.0.1", taken.getsockname()[1])


async def test_the_example_client_says_the_place(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    script = ROOT / "examples" / "place_client.py"

    async def run(address: str) -> tuple[int | None, str]:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            str(script),
            "--station",
            address,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        output, _ = await process.communicate()
        return process.returncode, output.decode()

    async with at_work(tmp_path) as (desk, _, _film):
        code, said = await run(desk.address)
        assert code == 1 and said.startswith("unknown: no map is active")
        await desk.http.put("/maps/active", json={"id": place_map.id})
        await wait_for(desk, "/place/current", lambda p: p["state"] == "known")
        code, said = await run(desk.address)
        assert code == 0 and said == f"at {place_map.places[0].name} (90%, 0.5 m from its middle): always here\n"
    code, said = await run("http://127.0.0.1:1")
    assert code == 2 and said.startswith("place_client: no station at")
