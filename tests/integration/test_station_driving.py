"""Driving through the station, by HTTP and WebSocket: who may, when it stops, where the camera looks."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from urllib.parse import quote

import msgspec
import pytest
import websockets

from shared.calibration import REFERENCE_ROBOT
from shared.messages import ErrorNotice
from shared.text import is_printable
from station.robots.session import MAX_STOP_LINES, MAX_WARNINGS
from tests.support.link import WAIT_S, Bench, Proxy, linked, running_robot, until
from tests.support.station import Desk, running_station, store_map
from tests.support.station_at_work import at_work, drive_off, heard, is_problem, wait_for


async def test_drive_moves_the_motors_until_the_driver_goes_silent(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        answer = await desk.http.post("/drive", json={"linear": 0.2, "angular": 0.5, "ttl_ms": 600})
        assert answer.status_code == 200
        await until(lambda: bench.motors.history and not bench.motors.are_off)
        began_ns = bench.motors.history[-1][0]
        await until(lambda: bench.motors.are_off)
        # Longer than the protocol's own life of a command: the station repeated it; then it ended by itself.
        assert bench.motors.history[-1][0] - began_ns > 300_000_000
        assert is_problem(await desk.http.post("/drive", json={"linear": 9.0, "angular": 0.0}), 422)


def freeze(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """For the drive timer no time passes: whatever stops the robot now, it is not the driver's silence."""
    monkeypatch.setattr(desk.station.first.driving, "_now_ns", lambda: 1)


async def test_stop_needs_no_lease_and_holds_until_the_driver_lets_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        freeze(desk, monkeypatch)
        order = {"linear": 0.2, "angular": 0.0, "ttl_ms": 1000}
        await drive_off(bench, lambda: desk.http.post("/drive", json=order, headers={"X-Driver": "anna"}))
        stops = bench.stops_heard
        assert (await desk.http.post("/stop", headers={"X-Driver": "ben"})).status_code == 200
        await until(lambda: bench.stops_heard > stops and bench.motors.are_off)
        held_on = await desk.http.post("/drive", json=order, headers={"X-Driver": "anna"})
        assert is_problem(held_on, 409) and "let go" in held_on.json()["detail"]


async def test_a_stop_on_a_dead_connection_is_told_as_not_confirmed_and_stops_the_robot_when_it_is_back(
    tmp_path: Path,
) -> None:
    """Neither end knows yet that it is dead, and another station drives on."""
    async with running_robot() as bench, proxied(bench) as proxy, running_station(proxy.port, tmp_path) as desk:
        await until(lambda: desk.station.first.state.connected)
        await until_confirmed(desk)
        async with linked(bench.port, "other") as (other, _):

            async def hold() -> None:
                other.commands.drive(0.1, 0.0, 250)

            await drive_off(bench, hold)
            proxy.stall()
            stops = bench.stops_heard
            answer = await desk.http.post("/stop")
            assert answer.status_code == 200 and answer.json()["confirmed"] is False
            assert bench.stops_heard == stops
            await proxy.cut()
            proxy.flow()
            await proxy.mend()
            await until(lambda: bench.stops_heard > stops and bench.motors.are_off)
            log = [line["text"] for line in await wait_for(desk, "/log", lambda lines: "again" in lines[-1]["text"])]
            assert any("has not confirmed it yet" in text for text in log)
            await until_confirmed(desk)


@asynccontextmanager
async def proxied(bench: Bench) -> AsyncIterator[Proxy]:
    proxy = Proxy(bench.port)
    await proxy.mend()
    try:
        yield proxy
    finally:
        await proxy.cut()


async def test_a_stop_is_confirmed_only_when_the_motors_took_it(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        await until_confirmed(desk)
        bench.motors.stop_fault = "the Mega is not connected"
        assert (await desk.http.post("/stop")).json()["confirmed"] is False
        await until(lambda: "do not answer STOP (the Mega is not connected)" in str(desk.station.first.link.state))
        bench.motors.stop_fault = ""
        await until(lambda: not desk.station.first.link.commands.awaits_stop)


async def until_confirmed(desk: Desk) -> None:
    while not (await desk.http.post("/stop")).json()["confirmed"]:
        await asyncio.sleep(0.05)


async def test_one_driver_at_a_time_until_taken_over_or_silent(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, _film):
        order = {"linear": 0.1, "angular": 0.0, "ttl_ms": 1000}  # keeps the wheel two seconds: the machine may be busy
        anna, ben = {"X-Driver": "anna"}, {"X-Driver": "ben"}
        assert (await desk.http.post("/drive", json=order, headers=anna)).status_code == 200
        refused = await desk.http.post("/drive", json=order, headers=ben)
        assert is_problem(refused, 409) and "anna" in refused.json()["detail"]
        # On a busy machine her last word may be old by now.
        while (driver := (await desk.http.get("/robot")).json()["driver"]) is None:
            assert (await desk.http.post("/drive", json=order, headers=anna)).status_code == 200
        assert driver == "anna"
        taken = (await desk.http.post("/drive/take-over", headers=ben)).json()
        assert (taken["driver"], taken["you_drive"]) == ("ben", True) and taken["keeps_s"] > 5
        assert is_problem(await desk.http.post("/drive", json=order, headers=anna), 409)
        await until(lambda: desk.station.first.driving.driver is None)  # a second of silence
        assert (await desk.http.post("/drive", json=order, headers=anna)).status_code == 200


async def test_nobody_is_told_to_drive_while_the_robot_says_that_another_station_does(tmp_path: Path) -> None:
    order, anna = {"linear": 0.1, "angular": 0.0, "ttl_ms": 1000}, {"X-Driver": "anna"}
    async with at_work(tmp_path) as (desk, bench, _film), linked(bench.port, "attic") as (other, _):

        async def hold() -> None:
            while True:
                other.commands.drive(0.1, 0.0, 250)
                await asyncio.sleep(0.05)

        holding = asyncio.create_task(hold())
        await wait_for(desk, "/robot", lambda robot: robot["robot_driver"] == "attic")
        refused = await desk.http.post("/drive", json=order, headers=anna)
        assert is_problem(refused, 409) and "another station (attic) drives" in refused.json()["detail"]
        assert is_problem(await desk.http.post("/pan-tilt", json={"pan": 0.1, "tilt": 0}, headers=anna), 409)
        assert (await desk.http.get("/robot")).json()["driver"] is None
        let_go = await desk.http.post("/drive", json=order | {"linear": 0.0}, headers=anna)
        assert let_go.status_code == 200 and not let_go.json()["you_drive"]
        async with websockets.connect(desk.socket("/ws/drive?driver=anna")) as wheel:
            await wheel.send('{"type": "take_over"}')  # of this station, against nobody
            replies = (json.loads(text) async for text in wheel)
            wheels = (reply["you_drive"] async for reply in replies if reply.get("driver") == "anna")
            assert await anext(wheels) is False
            holding.cancel()
            assert await anext(wheels) is True
        await wait_for(desk, "/robot", lambda robot: robot["robot_driver"] is None)
        assert (await desk.http.post("/drive", json=order, headers=anna)).json()["you_drive"]


async def test_a_drivers_name_forges_no_line_and_moves_no_terminal(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, _film):
        name = "ben\nstation: ERROR: forged\x1b[31m\x9b2J\u202e"
        async with websockets.connect(desk.socket(f"/ws/drive?driver={quote(name)}")) as wheel:
            await wheel.send('{"type": "take_over"}')
            await until(lambda: desk.station.first.driving.driver is not None)
        await desk.http.post("/drive/take-over", headers=[(b"X-Driver", b"anna\x9b2J")])
        told = [line["text"] for line in (await desk.http.get("/log")).json() if line["topic"] == "drive"]
        assert len(told) >= 2 and "forged" in told[0] and all(map(is_printable, told))


@pytest.mark.parametrize("length", [65, 300])
async def test_a_drivers_name_that_is_too_long_drives_neither_by_header_nor_by_socket_and_stops(
    tmp_path: Path, length: int
) -> None:
    name = "x" * length
    async with at_work(tmp_path) as (desk, bench, _film), asyncio.timeout(WAIT_S):
        refused = await desk.http.post("/drive/take-over", headers={"X-Driver": name})
        assert is_problem(refused, 422) and "64 characters" in refused.json()["detail"]
        async with websockets.connect(desk.socket(f"/ws/drive?driver={name}")) as wheel:
            await wheel.send('{"type": "take_over"}')
            replies = (json.loads(text) async for text in wheel)
            refusals = (reply async for reply in replies if reply["type"] == "refused")
            assert (await anext(refusals))["text"] == refused.json()["detail"]
            stops = bench.stops_heard
            await wheel.send('{"type": "stop"}')
            await until(lambda: bench.stops_heard > stops)
        assert desk.station.first.driving.driver is None


async def test_the_log_tells_who_has_the_wheel_and_who_stopped_the_robot(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, _film):
        order = {"linear": 0.1, "angular": 0.0, "ttl_ms": 1000}
        anna, ben = {"X-Driver": "anna"}, {"X-Driver": "ben"}
        for _ in range(2):
            await desk.http.post("/drive", json=order, headers=anna)
        await desk.http.post("/drive/take-over", headers=ben)
        for _ in range(3):  # as a program does that makes sure
            await desk.http.post("/stop", headers=anna)
        await desk.http.post("/drive/release", headers=ben)
        await desk.http.post("/drive", json=order, headers=ben)  # the wheel was free meanwhile, and nobody else's
        await desk.http.post("/drive/release", headers=ben)
        await desk.http.post("/drive", json=order, headers=anna)
        told = [line["text"] for line in (await desk.http.get("/log")).json() if line["topic"] == "drive"]
        assert told == ["anna drives", "ben took over from anna", "anna stopped the robot", "anna drives"]


async def test_a_program_that_repeats_its_stops_leaves_the_log_room(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _film):

        def told() -> list[str]:
            return [line.text for line in desk.station.first.events.log if "stopped" in line.text]

        robot = desk.station.first
        for _ in range(20):
            for why in ("tab hidden", "video stale"):
                robot.stop("anna", why)
        assert told() == ["anna stopped: tab hidden", "anna stopped: video stale"]
        for number in range(100):
            robot.stop(f"program {number}", f"{number} ms late")
        assert len(told()) == MAX_STOP_LINES
        order = {"linear": 0.1, "angular": 0.0, "ttl_ms": 1000}
        await drive_off(bench, lambda: desk.http.post("/drive", json=order, headers={"X-Driver": "ben"}))
        robot.stop("anna", "tab hidden")  # of a robot that moved: that is news
        assert told()[MAX_STOP_LINES:] == ["anna stopped: tab hidden"]


async def test_without_a_robot_there_is_no_wheel_to_take(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        refused = await desk.http.post("/drive/take-over", headers={"X-Driver": "anna"})
        assert is_problem(refused, 503) and refused.json()["type"] == "/problems/no-robot"
        assert (await desk.http.get("/robot")).json()["driver"] is None


async def test_closing_the_drive_socket_stops_the_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        freeze(desk, monkeypatch)
        async with websockets.connect(desk.socket("/ws/drive?driver=page")) as socket:
            assert await heard(socket) == {"type": "driver", "driver": None, "you_drive": False}
            await socket.send(json.dumps({"type": "drive", "seq": 1, "linear": 0.2, "angular": 0, "ttl_ms": 1000}))
            told = [await heard(socket) for _ in range(2)]
            assert {"type": "accepted", "seq": 1} in told
            assert {"type": "driver", "driver": "page", "you_drive": True} in told
            again = json.dumps({"type": "drive", "seq": 2, "linear": 0.2, "angular": 0, "ttl_ms": 1000})
            await drive_off(bench, lambda: socket.send(again))
            stops = bench.stops_heard
        await until(lambda: bench.stops_heard > stops and bench.motors.are_off)
        assert desk.station.first.driving.driver is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "JSON"),
        ("{}", "type"),
        ('{"type": "fly"}', "fly"),
        ('{"type": "drive", "seq": 1, "linear": "x", "angular": 0}', "linear: "),
        ('{"type": "drive", "seq": 1, "linear": 0, "angular": 0, "\\u001b[2J": 1}', "\ufffd[2J: "),
        ("[1]", "object"),
    ],
)
async def test_nonsense_on_the_drive_socket_is_refused_and_the_socket_lives(
    tmp_path: Path, text: str, said: str
) -> None:
    async with (
        running_station(1, tmp_path) as desk,
        websockets.connect(desk.socket("/ws/drive?driver=page")) as socket,
    ):
        await heard(socket)
        await socket.send(text)
        refused = await heard(socket)
        assert refused["type"] == "refused" and said in refused["text"]
        await socket.send(json.dumps({"type": "drive", "seq": 1, "linear": 0.1, "angular": 0.0}))
        assert (await heard(socket))["problem"] == "no-robot"


async def test_what_a_page_said_before_everything_froze_moves_nothing_after(tmp_path: Path) -> None:
    """The station stood still, or the network did; the page's commands wait in the socket and then come all at once."""
    async with (
        at_work(tmp_path) as (desk, bench, _),
        websockets.connect(desk.socket("/ws/drive?driver=page")) as socket,
    ):
        while (answer := json.loads(await socket.recv()))["type"] != "time":
            continue
        order = {"type": "drive", "linear": 0.2, "angular": 0.0}
        for seq in range(60):
            await socket.send(json.dumps({**order, "seq": seq, "heard_ms": answer["t_ms"] - 251}))
        await socket.send(json.dumps({"type": "release"}))
        await socket.send(json.dumps({**order, "seq": 60}))
        # The first accepted one is the one that was said after it all.
        while (answer := await heard(socket))["type"] != "accepted":
            continue
        assert answer["seq"] == 60
        await drive_off(bench, lambda: socket.send(json.dumps({**order, "seq": 61})))


async def test_a_zero_that_comes_late_stops_what_moves_and_counts_for_nothing_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with (
        at_work(tmp_path) as (desk, bench, _),
        websockets.connect(desk.socket("/ws/drive?driver=page")) as socket,
    ):
        freeze(desk, monkeypatch)
        while (answer := json.loads(await socket.recv()))["type"] != "time":
            continue

        async def say_late_zero(seq: int) -> list[int]:
            """Which commands were accepted by the time it has been read."""
            zero = {"type": "drive", "linear": 0.0, "angular": 0.0, "seq": seq, "heard_ms": answer["t_ms"] - 251}
            await socket.send(json.dumps(zero))
            await socket.send("nonsense")
            accepted = []
            while (reply := await heard(socket))["type"] != "refused":
                accepted += [reply["seq"]] if reply["type"] == "accepted" else []
            return accepted

        assert await say_late_zero(1) == []
        order = {"linear": 0.2, "angular": 0.0, "ttl_ms": 1000}
        await drive_off(bench, lambda: desk.http.post("/drive", json=order, headers={"X-Driver": "page"}))
        assert desk.station.first.driving.is_moving
        assert await say_late_zero(2) == [2]
        assert not desk.station.first.driving.is_moving
        await until(lambda: bench.motors.are_off)


async def test_a_page_behind_a_slow_link_is_told_why_nothing_moves(tmp_path: Path) -> None:
    async with (
        at_work(tmp_path) as (desk, bench, _),
        websockets.connect(desk.socket("/ws/drive?driver=page")) as socket,
    ):
        order = {"type": "drive", "linear": 0.2, "angular": 0.0, "ttl_ms": 200}
        answer = json.loads(await socket.recv())
        for seq in itertools.count():
            while answer["type"] not in ("time", "refused"):
                answer = json.loads(await socket.recv())
            if answer["type"] == "refused":
                break
            # Twenty times a second, with the station's clock as it was 300 ms ago.
            await socket.send(json.dumps({**order, "seq": seq, "heard_ms": answer["t_ms"] - 300}))
            answer = json.loads(await socket.recv())
        assert answer["problem"] == "late" and "too slow" in answer["text"]
        assert desk.station.first.driving.driver is None and bench.motors.are_off


async def test_pan_tilt_reaches_the_head(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        assert (await desk.http.post("/pan-tilt", json={"pan": 0.3, "tilt": -0.1})).status_code == 200
        await until(lambda: bench.head.pointed[-1:] == [(0.3, -0.1)])
        await until(lambda: (applied := desk.station.first.applied) is not None and applied.pan == 0.3)
        assert is_problem(await desk.http.post("/pan-tilt", json={"pan": 9.0, "tilt": 0.0}), 422)
        aside = await desk.http.post("/navigations")
        assert is_problem(aside, 409) and "straight ahead" in aside.json()["detail"]
        await desk.http.post("/pan-tilt", json={"pan": 0.0, "tilt": 0.0})
        await desk.http.post("/navigations")
        assert "a navigation is being recorded" in (await desk.http.get("/robot")).json()["head_must_rest"]
        assert is_problem(await desk.http.post("/pan-tilt", json={"pan": 0.3, "tilt": 0.0}), 409)
        assert (await desk.http.post("/pan-tilt", json={"pan": 0.0, "tilt": 0.0})).status_code == 200


async def test_the_head_may_turn_while_a_backend_records_that_knows_where_it_is(tmp_path: Path) -> None:
    async with at_work(tmp_path, backend="ukf") as (desk, bench, _):
        assert (await desk.http.post("/navigations")).status_code == 201
        assert (await desk.http.get("/robot")).json()["head_must_rest"] == ""
        assert (await desk.http.post("/pan-tilt", json={"pan": 0.3, "tilt": -0.1})).status_code == 200
        await until(lambda: bench.head.pointed[-1:] == [(0.3, -0.1)])


async def test_the_place_is_looked_for_with_a_head_that_looks_aside(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with at_work(tmp_path) as (desk, bench, _):
        await desk.http.post("/pan-tilt", json={"pan": 0.3, "tilt": -0.1})
        await desk.http.put("/maps/active", json={"id": place_map.id})
        await wait_for(desk, "/place/current", lambda p: p["state"] == "known")
        await until(lambda: bench.head.pointed[-1] == (0.3, -0.1))  # servos are led there
        answers = desk.station.first.current_place.answers
        await until(lambda: desk.station.first.current_place.answers > answers + 2)
        assert "looks aside" not in (await desk.http.get("/place/current")).json()["reason"]


async def test_a_head_that_is_not_calibrated_is_centred_when_a_map_becomes_active(tmp_path: Path) -> None:
    place_map = store_map(tmp_path)
    async with at_work(tmp_path, msgspec.structs.replace(REFERENCE_ROBOT, head=None)) as (desk, bench, _):
        await desk.http.post("/pan-tilt", json={"pan": 0.3, "tilt": -0.1})
        await until(lambda: bench.head.pointed[-1:] == [(0.3, -0.1)])
        await desk.http.put("/maps/active", json={"id": place_map.id})
        await until(lambda: bench.head.pointed[-1] == (0.0, 0.0))
        # It may look around all the same: then the place is not looked for, and the answer says so.
        await wait_for(desk, "/place/current", lambda p: p["state"] == "known")
        assert (await desk.http.post("/pan-tilt", json={"pan": 0.3, "tilt": 0.0})).status_code == 200
        answers = desk.station.first.current_place.answers
        assert "looks aside" in (await desk.http.get("/place/current")).json()["reason"]
        await desk.http.post("/pan-tilt", json={"pan": 0.0, "tilt": 0.0})
        await until(lambda: desk.station.first.current_place.answers > answers + 2)
        assert "looks aside" not in (await desk.http.get("/place/current")).json()["reason"]


async def test_a_robot_that_warns_without_end_leaves_the_log_room_for_other_lines(tmp_path: Path) -> None:
    async with running_station(1, tmp_path) as desk:
        robot = desk.station.first
        for number in range(300):
            robot.on_notice(ErrorNotice(code="device", message="the camera is gone"))
            robot.on_notice(ErrorNotice(code="device", message=f"it is {number} degrees too warm"))
            robot.on_gap(1 + number)
        warned = [line.text for line in robot.events.log if line.level == "warning"]
        assert warned.count("the camera is gone") == 1
        assert sum("samples were lost" in text for text in warned) == 1
        assert len(warned) == MAX_WARNINGS
        robot.on_notice(ErrorNotice(code="shutdown", message="robot-server ends", fatal=True))
        assert robot.events.log[-1].text == "robot-server ends"
