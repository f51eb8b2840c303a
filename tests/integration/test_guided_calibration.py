"""The guided calibration over HTTP: a made-up camera sees a printed board, is calibrated, and the robot tells it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from station.datasets import open_dataset
from station.workers.worker import Worker
from tests.support.board_bench import BUILT, HELD, TOLD, before_a_board
from tests.support.link import linked, until
from tests.support.station import running_station
from tests.support.station_at_work import drive_off, is_problem, wait_for

ORDER = {"kind": "camera", "target": {"kind": "aprilgrid", "size": "A4"}}


async def test_a_robot_that_tells_another_camera_is_calibrated_and_tells_its_own(tmp_path: Path) -> None:
    async with before_a_board(tmp_path) as (desk, _, showing):
        http = desk.http
        session = (await http.post("/calibration/sessions", json=ORDER)).json()
        path = f"/calibration/sessions/{session['id']}"
        assert is_problem(await http.post("/navigations"), 409)  # one thing at a time
        assert is_problem(await http.post("/calibration/sessions", json=ORDER), 409)
        await showing.show_all(desk)
        seen = (await http.get(path)).json()["seen"]
        assert seen["num_views"] >= 12 and seen["instruction"] and len(seen["cells"]) == 9
        assert {reading["name"] for reading in seen["meter"]} == {"focal length", "centre", "distortion"}
        assert len(seen["corners_px"]) >= 40
        assert is_problem(await http.post("/calibration/use", json={"session": session["id"]}), 409)
        job = (await http.post(f"{path}/finish")).json()
        done = await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["state"] != "running")
        assert done["state"] == "done", done["message"]
        result = (await http.get(path)).json()["result"]
        assert result["accepted"], result["reasons"]
        fx, fy, cx, cy = result["intrinsics"]
        assert (fx, fy) == pytest.approx((BUILT.fx, BUILT.fy), rel=0.01)
        assert (cx, cy) == pytest.approx((BUILT.cx, BUILT.cy), abs=4.0)
        assert (await http.get(f"{path}/residuals.png")).content.startswith(b"\x89PNG")
        recording = await http.get(f"{path}/recording.mcap")
        (tmp_path / "again.mcap").write_bytes(recording.content)
        data = open_dataset(tmp_path / "again.mcap")  # an ordinary recording, of both sensors
        assert len(data.frame_times_ns) > len(HELD) and data.calibration.imu is not None
        told = (await http.post("/calibration/use", json={"session": session["id"]})).json()
        assert told["camera"]["intrinsics"] == result["intrinsics"] and told["can_undo"]
        assert told["camera"]["time_shift_s"] == TOLD.time_shift_s  # of which it says nothing
        undone = (await http.post("/calibration/undo")).json()
        assert undone["camera"]["intrinsics"][0] == TOLD.fx


async def test_one_view_is_refused_and_what_is_given_up_is_gone(tmp_path: Path) -> None:
    async with before_a_board(tmp_path) as (desk, _, _):
        http = desk.http
        session = (await http.post("/calibration/sessions", json=ORDER)).json()
        path = f"/calibration/sessions/{session['id']}"
        await wait_for(desk, path, lambda s: s["seen"] is not None and s["seen"]["num_views"] == 1)
        job = (await http.post(f"{path}/finish")).json()
        await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["state"] != "running")
        over = (await http.get(path)).json()
        assert over["state"] == "done" and not over["result"]["accepted"] and "too few" in over["result"]["reasons"][0]
        refused = await http.post("/calibration/use", json={"session": session["id"]})
        assert is_problem(refused, 409) and "too few" in refused.json()["detail"]
        assert (await http.delete(path)).status_code == 204
        assert is_problem(await http.get(path), 404) and not any((tmp_path / "calibrations").iterdir())
        wrong = {"kind": "camera", "target": {"kind": "chessboard", "columns": 7, "rows": 1, "square_m": 0.02}}
        assert is_problem(await http.post("/calibration/sessions", json=wrong), 422)
        assert (await http.post("/navigations")).status_code == 201


async def test_the_robot_stands_while_a_board_is_held_before_it(tmp_path: Path) -> None:
    async with before_a_board(tmp_path) as (desk, bench, _):
        http = desk.http
        forward = {"linear": 0.1, "angular": 0.0, "ttl_ms": 1000}
        await drive_off(bench, lambda: http.post("/drive", json=forward))
        begun = await http.post("/calibration/sessions", json=ORDER)
        assert begun.status_code == 201 and not desk.station.first.driving.is_moving
        refused = await http.post("/drive", json=forward)
        assert is_problem(refused, 409) and "board" in refused.json()["detail"]
        await until(lambda: bench.motors.are_off)
        assert (await http.post("/drive", json=forward | {"linear": 0.0})).status_code == 200
        await http.delete(f"/calibration/sessions/{begun.json()['id']}")
        await drive_off(bench, lambda: http.post("/drive", json=forward))


async def test_wheels_are_measured_while_the_robot_drives_and_an_imu_without_a_board_while_it_stands(
    tmp_path: Path,
) -> None:
    async with before_a_board(tmp_path) as (desk, bench, _):
        http = desk.http
        forward = {"linear": 0.1, "angular": 0.0, "ttl_ms": 1000}
        begun = await http.post("/calibration/sessions", json=ORDER | {"kind": "wheels"})
        assert begun.status_code == 201, begun.text
        path = f"/calibration/sessions/{begun.json()['id']}"
        seen = (await wait_for(desk, path, lambda s: s["seen"] is not None))["seen"]
        assert set(seen["poses"]) == {"forth", "back", "left", "right"} and not seen["may_finish"]
        await drive_off(bench, lambda: http.post("/drive", json=forward))
        await wait_for(desk, path, lambda s: "let go" in s["seen"]["instruction"])
        await http.delete(path)
        await http.post("/stop")
        assert is_problem(await http.post("/calibration/sessions", json=ORDER | {"kind": "imu"}), 422)
        begun = await http.post("/calibration/sessions", json={"kind": "imu"})
        assert begun.status_code == 201, begun.text
        refused = await http.post("/drive", json=forward)
        assert is_problem(refused, 409) and "at rest" in refused.json()["detail"]
        path = f"/calibration/sessions/{begun.json()['id']}"
        seen = (await wait_for(desk, path, lambda s: s["seen"] is not None))["seen"]
        assert set(seen["poses"]) == {"time"} and not seen["may_finish"]


async def test_a_check_needs_no_board_and_says_what_a_robot_that_was_not_carried_about_lacks(tmp_path: Path) -> None:
    async with before_a_board(tmp_path) as (desk, _, _):
        http = desk.http
        assert is_problem(await http.post("/calibration/sessions", json=ORDER | {"kind": "check"}), 422)
        begun = await http.post("/calibration/sessions", json={"kind": "check"})
        assert begun.status_code == 201, begun.text
        path = f"/calibration/sessions/{begun.json()['id']}"
        seen = (await wait_for(desk, path, lambda s: s["seen"] is not None))["seen"]
        assert set(seen["poses"]) == {"roll", "tilt", "turn", "time"} and not seen["may_finish"]
        refused = await http.post("/drive", json={"linear": 0.1, "angular": 0.0, "ttl_ms": 1000})
        assert is_problem(refused, 409) and "carries the robot" in refused.json()["detail"]
        job = (await http.post(f"{path}/finish")).json()
        done = await wait_for(desk, f"/jobs/{job['id']}", lambda j: j["state"] != "running")
        assert done["state"] == "done", done["message"]
        over = (await http.get(path)).json()
        assert over["state"] == "done" and not over["check"]["accepted"] and over["check"]["reasons"]
        assert over["check"]["fits"] is None and over["mounting"] is None
        assert is_problem(await http.post("/calibration/use", json={"session": begun.json()["id"]}), 409)


async def test_no_other_station_drives_while_a_board_is_held_before_the_robot(tmp_path: Path) -> None:
    async with before_a_board(tmp_path) as (desk, bench, _), linked(bench.port, "other") as (other, notes):
        begun = (await desk.http.post("/calibration/sessions", json=ORDER)).json()
        await until(lambda: bench.server.desk.is_handled)
        async with asyncio.timeout(60):
            while not any("handles the robot" in notice.message for notice in notes.notices):
                other.commands.drive(0.1, 0.0, 200)
                await asyncio.sleep(0.05)
        assert bench.motors.are_off
        await desk.http.delete(f"/calibration/sessions/{begun['id']}")
        async with asyncio.timeout(60):
            while bench.motors.are_off:
                other.commands.drive(0.1, 0.0, 200)
                await asyncio.sleep(0.05)


async def test_the_board_is_printed_from_the_page(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        page = await desk.http.get("/calibration/target.pdf?kind=charuco&size=Letter")
        assert page.headers["content-type"] == "application/pdf" and page.content.startswith(b"%PDF")
        assert is_problem(await desk.http.get("/calibration/target.pdf?size=A9"), 422)


async def test_a_page_that_many_ask_for_at_once_is_drawn_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, start = list[str](), Worker.start

    async def count(worker: Worker[Any, Any]) -> None:
        begun.append(worker.name)
        await start(worker)

    monkeypatch.setattr(Worker, "start", count)
    async with running_station(1, tmp_path) as desk:
        pages = await asyncio.gather(*(desk.station.target_page("chessboard", "A4") for _ in range(3)))
    assert len(set(pages)) == 1 and pages[0].startswith(b"%PDF")
    assert begun.count("calibration target") == 1
