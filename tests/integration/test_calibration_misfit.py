"""A calibration that does not fit, from the SLAM worker's program to the files, and from there to HTTP."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from shared.calibration import CameraCalibration
from station.datasets import open_dataset
from station.files.navigation_folder import load_navigation
from station.model.frames import DriveSample, ImuBatch
from station.model.navigation import Navigation
from station.model.slam_update import SlamUpdate
from station.workers.slam import NavigationSlam
from tests.support.paths import RECORDINGS
from tests.support.station_at_work import at_work, wait_for

FLIGHT = RECORDINGS / "euroc_v1_01_flight"


def fly(focal: float, folder: Path) -> tuple[CameraCalibration, Navigation]:
    """Four seconds of a real flight with a focal length that is told `focal` times as long: told, and what came out."""
    data = open_dataset(FLIGHT, None, None, 1)
    camera = data.calibration.camera
    assert camera is not None
    camera = msgspec.structs.replace(camera, fx=focal * camera.fx, fy=focal * camera.fy)
    updates: list[SlamUpdate] = []
    slam = NavigationSlam(updates.append)
    slam.begin("ukf", msgspec.structs.replace(data.calibration, camera=camera), 0)
    for event in data.events():
        if isinstance(event, ImuBatch):
            gyro, accel = event.gyro_imu.tolist(), event.accel_imu.tolist()
            slam.add_imu(event.t_robot_ns.tolist(), gyro, accel)
        elif isinstance(event, DriveSample):
            slam.add_drive(event)
        else:
            slam.add_frame(event)
    slam.finish("flight", folder)
    return camera, load_navigation(folder)


@pytest.mark.skipif(not FLIGHT.exists(), reason="the recorded flight is not here")
@pytest.mark.parametrize(("focal", "verdict"), [(1.0, "fits"), (0.95, "does not fit"), (1.05, "does not fit")])
def test_a_real_flight_says_whether_its_focal_length_is_right(focal: float, verdict: str, tmp_path: Path) -> None:
    told, navigation = fly(focal, tmp_path / "navigation")
    report, used = navigation.report, navigation.calibration.camera
    fit, messages = report.calibration_fit, "; ".join(report.messages)
    assert fit is not None and used is not None
    assert used == told and report.told_camera is None  # a map from tracks is not corrected
    assert fit.verdict == verdict
    assert fit.focal_scale == pytest.approx(1.0 / focal, abs=0.015)  # four seconds, one window
    assert (fit.sentence in messages) == (verdict == "does not fit")


async def test_a_misfit_is_told_by_the_robots_call_and_once_in_the_log(tmp_path: Path) -> None:
    async with at_work(tmp_path, backend="tests.support.made_up_workers:MisfitSlam") as (desk, _, _):
        http = desk.http
        assert (await http.get("/robot")).json()["calibration_fit"] is None
        await http.post("/navigations", json={"name": "with a wrong lens"})
        robot = await wait_for(desk, "/robot", lambda r: r["calibration_fit"] is not None)
        fit = robot["calibration_fit"]
        assert fit["verdict"] == "does not fit" and fit["focal_scale"] == pytest.approx(0.97)
        await wait_for(desk, "/pose", lambda slam: slam["frames"] >= 10)
        told = [line["text"] for line in (await http.get("/log")).json() if line["topic"] == "calibration"]
        assert told == [fit["sentence"]]
