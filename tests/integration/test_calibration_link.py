"""Another calibration for a robot, over HTTP and the link: told at once, kept, undone, refused in words."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import msgspec
import pytest
import yaml

from robot.own_calibration import OwnCalibration
from shared.access import Role
from shared.calibration import REFERENCE_ROBOT, Calibration
from shared.framing import MAX_STATION_PAYLOAD, encode_payload
from shared.message_codec import encode_message
from shared.messages import PROTOCOL_VERSION, Join
from station.calibration.target import Target
from station.datasets import open_dataset
from station.robots.guided_calibration import CalibrationSession
from tests.support.access import guarded_station
from tests.support.link import linked, running_robot, until
from tests.support.station_at_work import at_work, drive_off, is_problem, wait_for

LENS = {"camera": {"intrinsics": [1001.5, 1002.5, 321.0, 241.0], "time_shift_s": -0.0125}}


TARGET = Target("aprilgrid", 6, 6, 0.024, gap_m=0.0072)
GOOD = {
    "model": "radtan",
    "resolution": [640, 480],
    "intrinsics": [1001.5, 1002.5, 321.0, 241.0],
    "distortion": [0.0, 0.0, 0.0, 0.0],
    "rms_px": 0.1,
    "sigma": {},
    "images_used": 20,
    "images_rejected": [],
    "coverage": 1.0,
    "line_delay_s": None,
    "accepted": True,
    "reasons": [],
}


class SlowCalibration(OwnCalibration):
    """Written when the test says so."""

    def __init__(self) -> None:
        super().__init__(None, REFERENCE_ROBOT)
        self.is_asked, self.may_write = threading.Event(), threading.Event()

    def use(self, calibration: Calibration) -> None:
        self.is_asked.set()
        self.may_write.wait(60)
        super().use(calibration)


def focal(calibration: Calibration) -> float:
    assert calibration.camera is not None
    return calibration.camera.fx


async def test_a_calibration_is_told_by_the_robot_from_then_on_kept_and_undone(tmp_path: Path) -> None:
    async with at_work(tmp_path / "station") as (desk, bench, _):
        bench.server.recalibration.own = OwnCalibration(tmp_path / "own", REFERENCE_ROBOT)
        before = (await desk.http.get("/calibration")).json()
        assert before["camera"]["intrinsics"][0] == 1083.4 and not before["can_undo"] and before["fixed"] == ""
        async with linked(bench.port) as (other, notes):
            await until(lambda: other.state.connected)
            told = (await desk.http.post("/calibration/use", json=LENS)).json()
            assert told["camera"]["intrinsics"] == LENS["camera"]["intrinsics"] and told["can_undo"]
            assert told["camera"]["time_shift_s"] == -0.0125 and told["camera"]["is_measured"]
            assert told["camera"]["T_body_cam"] == before["camera"]["T_body_cam"] and told["imu"] == before["imu"]
            assert (await desk.http.get("/calibration")).json() == told
            # Every station hears it, without a new connection.
            await until(lambda: notes.calibrations and focal(notes.calibrations[-1].calibration) == 1001.5)
            assert other.state.connections == 1
        fresh = OwnCalibration(tmp_path / "own", REFERENCE_ROBOT)  # as robot-server's next start reads it
        assert focal(fresh.current) == 1001.5
        await bench.stop()
        await bench.start()
        bench.server.recalibration.own = fresh
        await wait_for(desk, "/robot", lambda r: r["connected"] and r["connections"] == 2)
        assert (await desk.http.get("/calibration")).json() == told
        assert (await desk.http.post("/calibration/undo")).json()["camera"] == before["camera"]
        assert (await desk.http.post("/calibration/undo")).json()["camera"] == told["camera"]


async def test_what_cannot_be_is_refused_with_the_reason_and_changes_nothing(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        before = (await desk.http.get("/calibration")).json()
        refusals = {
            "outside the picture": {"camera": {"intrinsics": [1000.0, 1000.0, 900.0, 240.0]}},
            "1280x720": {"camera": {"resolution": [1280, 720]}},
            "give the distortion too": {"camera": {"model": "equidistant"}},
            "no rigid motion": {"camera": {"T_body_cam": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [9, 9, 9, 9]]}},
            "within 10 s": {"camera": {"time_shift_s": 60.0}},
            "at least one number": {},
        }
        for words, order in refusals.items():
            answer = await desk.http.post("/calibration/use", json=order)
            assert is_problem(answer, 422) and words in answer.json()["detail"], answer.json()
        nothing = await desk.http.post("/calibration/undo")
        assert is_problem(nothing, 422) and "nothing to undo" in nothing.json()["detail"]
        await drive_off(bench, lambda: desk.http.post("/drive", json={"linear": 0.1, "angular": 0.0, "ttl_ms": 250}))
        driving = await desk.http.post("/calibration/use", json=LENS)
        assert is_problem(driving, 409) and "being driven" in driving.json()["detail"]
        assert (await desk.http.get("/calibration")).json() == before


async def test_two_orders_at_once_are_both_followed(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, _):
        noise = {"imu": {"gyro_noise_density": 0.0025}}
        answers = await asyncio.gather(*(desk.http.post("/calibration/use", json=order) for order in (LENS, noise)))
        assert [answer.status_code for answer in answers] == [200, 200]
        told = (await desk.http.get("/calibration")).json()
        assert told["camera"]["intrinsics"] == LENS["camera"]["intrinsics"]
        assert told["imu"]["gyro_noise_density"] == 0.0025


async def test_a_result_of_another_robot_is_not_written_into_the_present_one(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, _):
        before = (await desk.http.get("/calibration")).json()
        assert REFERENCE_ROBOT.camera is not None
        desk.station.first.guided_calibration.session = CalibrationSession(
            "cal-1", "camera", TARGET, tmp_path, REFERENCE_ROBOT, "another", state="done", result=GOOD
        )
        answer = await desk.http.post("/calibration/use", json={"session": "cal-1"})
        assert is_problem(answer, 409) and "another robot" in answer.json()["detail"]
        assert (await desk.http.get("/calibration")).json() == before


async def test_nothing_begins_while_a_calibration_is_being_written(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        bench.server.recalibration.own = own = SlowCalibration()
        writing = asyncio.create_task(desk.http.post("/calibration/use", json=LENS))
        try:
            await until(own.is_asked.is_set)
            board = {"kind": "camera", "target": {"kind": "aprilgrid", "size": "A4"}}
            for path, order in (("/navigations", {}), ("/calibration/sessions", board)):
                answer = await desk.http.post(path, json=order)
                assert is_problem(answer, 409) and "being written" in answer.json()["detail"]
        finally:
            own.may_write.set()
        assert (await writing).status_code == 200


async def test_a_robot_whose_folder_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    async with at_work(tmp_path / "station") as (desk, bench, _):
        bench.server.recalibration.own = OwnCalibration(tmp_path / "file" / "own", REFERENCE_ROBOT)
        answer = await desk.http.post("/calibration/use", json=LENS)
        assert is_problem(answer, 409) and "set calibration.folder" in answer.json()["detail"]


async def test_while_an_older_station_is_there_that_could_not_be_told_the_calibration_stays(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _):
        older = encode_payload(encode_message(Join(protocol=PROTOCOL_VERSION, station_name="old")), MAX_STATION_PAYLOAD)
        _, writer = await asyncio.open_connection("127.0.0.1", bench.port)
        try:
            writer.write(older)
            await until(lambda: (status := desk.station.first.state.status) is not None and status.stations == 2)
            answer = await desk.http.post("/calibration/use", json=LENS)
            assert is_problem(answer, 409) and "old runs an older release" in answer.json()["detail"]
        finally:
            writer.close()
        while (await desk.http.post("/calibration/use", json=LENS)).status_code != 200:
            await asyncio.sleep(0.05)


async def test_a_navigation_keeps_the_calibration_it_was_made_with(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, film):
        drive = (await desk.http.post("/navigations")).json()
        seen = film.count + 10
        await until(lambda: film.count > seen)
        busy = await desk.http.post("/calibration/use", json=LENS)
        assert is_problem(busy, 409) and "being recorded" in busy.json()["detail"]
        # Another station's admin may: then the recording ends where the calibration does.
        async with linked(bench.port) as (other, _):
            await until(lambda: other.state.connected)
            assert REFERENCE_ROBOT.camera is not None
            camera = msgspec.structs.replace(REFERENCE_ROBOT.camera, fx=1001.5)
            new = msgspec.structs.replace(REFERENCE_ROBOT, camera=camera)
            assert await other.commands.use_calibration(new, REFERENCE_ROBOT) is None
        over = await wait_for(desk, f"/navigations/{drive['id']}", lambda d: d["state"] in ("ready", "failed"))
        assert over["state"] == "ready" and "another calibration" in over["message"]
        folder = desk.station.navigations.library.folder(drive["id"])
        assert focal(open_dataset(folder / "recording.mcap").calibration) == 1083.4
        again = (await desk.http.post("/navigations")).json()
        seen = film.count + 10
        await until(lambda: film.count > seen)
        await desk.http.post(f"/navigations/{again['id']}/stop")
        await wait_for(desk, f"/navigations/{again['id']}", lambda d: d["state"] in ("ready", "failed"))
        recording = desk.station.navigations.library.folder(again["id"]) / "recording.mcap"
        assert focal(open_dataset(recording).calibration) == 1001.5


async def test_an_order_made_of_what_the_robot_tells_no_more_is_refused(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, bench, _), linked(bench.port) as (other, _notes):
        await until(lambda: other.state.connected)
        assert (await desk.http.post("/calibration/use", json=LENS)).status_code == 200
        outdated = msgspec.structs.replace(REFERENCE_ROBOT, camera=None)  # as if our change had not reached it yet
        for wanted in (REFERENCE_ROBOT, None):
            refusal = await other.commands.use_calibration(wanted, outdated)
            assert refusal is not None and "meanwhile" in refusal.message
        assert (await desk.http.get("/calibration")).json()["camera"]["intrinsics"][0] == 1001.5
        hello = other.state.hello
        assert hello is not None and focal(hello.calibration) == 1001.5  # by now it was told
        assert await other.commands.use_calibration(None, hello.calibration) is None
        await wait_for(desk, "/calibration", lambda told: told["camera"]["intrinsics"][0] == 1083.4)


async def test_the_calibration_is_fetched_as_our_file_and_as_kalibrs(tmp_path: Path) -> None:
    async with at_work(tmp_path) as (desk, _, _):
        ours = await desk.http.get("/calibration/file")
        assert 'filename="calibration.yaml"' in ours.headers["content-disposition"]
        assert yaml.safe_load(ours.text)["camera"]["intrinsics"] == [1083.4, 1076.4, 335.0879, 257.0793]
        chain = yaml.safe_load((await desk.http.get("/calibration/file?format=camchain")).text)["cam0"]
        assert chain["timeshift_cam_imu"] == -0.04175 and chain["distortion_model"] == "radtan"
        camera = REFERENCE_ROBOT.camera
        assert camera is not None
        assert chain["T_cam_imu"] == pytest.approx(camera.T_cam_body_matrix, abs=1e-12)  # kalibr: IMU to camera


async def test_only_an_admin_gives_a_robot_another_calibration(tmp_path: Path) -> None:
    async with running_robot() as bench, guarded_station(tmp_path, bench.port) as guarded:
        http = guarded.desk.http
        await until(lambda: guarded.desk.station.first.state.connected)
        for role in (Role.WATCH, Role.DRIVE):
            assert (await http.get("/calibration", headers=guarded.headers(role))).status_code == 200
            for call in ("use", "undo"):
                answer = await http.post(f"/calibration/{call}", json=LENS, headers=guarded.headers(role))
                assert is_problem(answer, 403)
        assert (await http.post("/calibration/use", json=LENS, headers=guarded.headers(Role.ADMIN))).status_code == 200
