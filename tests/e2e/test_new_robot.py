"""The way of a new robot: built with another camera than it tells, calibrated on the page before a board that a script
holds, and telling its own camera from then on.

All the way, with the drives before and after and the place at the end: `python -m benchmarks.bench_new_robot`.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.async_api import Browser, Locator, Page, expect

from robot.simulation.config import BodyParameters, BuildErrors
from robot.simulation.construction import built_camera
from shared.calibration import REFERENCE_CAMERA, REFERENCE_IMU
from shared.geometry import so3_log
from shared.simulator_link import SimulatorLink
from station.calibration.camera_imu.recording import IMAGES_PER_S
from tests.e2e.conftest import LAPTOP, PHONE
from tests.support.new_robot import (
    carry_about_until_all_is_recorded,
    choose_own_board,
    drive_until_all_goes_straight,
    hold_everywhere,
    new_robot,
    open_dialog,
    wave_until_all_is_recorded,
)
from tests.support.station import Desk, running_station

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.timeout(1500),
    pytest.mark.asyncio(loop_scope="module"),
]

BUILD_SEED = 4
MOUNTED_OTHERWISE = {"pitch_deg": 3.0, "yaw_deg": -2.0, "forward_cm": 1.5, "up_cm": -1.0, "time_shift_ms": 12.0}
KNOCKED = {"pitch_deg": 3.0, "yaw_deg": -2.0, "time_shift_ms": 12.0}
WAVED_S = 25.0
CARRIED_S = 45.0  # at most: until enough is recorded
# Pictures a second, where fewer do: of a board that is held and of wheels those at rest matter, of a robot that is
# waved the estimate takes so many, of an IMU none. Drawing and showing them takes most of the time.
STANDING_HZ, WAVED_HZ, UNSEEN_HZ = 10.0, IMAGES_PER_S, 2.0


@dataclass(frozen=True, slots=True)
class Room:
    """A new robot, its station, and the dialog on a page."""

    simulator: SimulatorLink
    desk: Desk
    page: Page
    dialog: Locator


@asynccontextmanager
async def new_robot_at_the_page(
    browser: Browser, folder: Path, built: dict[str, float], screen: dict[str, Any], camera_rate_hz: float = 20.0
) -> AsyncIterator[Room]:
    """`built`: BuildErrors."""
    async with (
        new_robot(folder, built, camera_rate_hz) as (port, simulator),
        running_station(port, folder / "station") as desk,
        await browser.new_context(**screen) as context,
    ):
        page = await context.new_page()
        yield Room(simulator, desk, page, await open_dialog(page, desk.address))


async def test_a_robot_built_otherwise_than_it_tells_is_calibrated_and_tells_its_own_camera(
    browser: Browser, tmp_path: Path
) -> None:
    told = REFERENCE_CAMERA
    built = built_camera(told, BuildErrors(seed=BUILD_SEED))
    assert abs(built.fx / told.fx - 1) > 0.05  # else there is nothing to find
    async with new_robot_at_the_page(browser, tmp_path, {"seed": BUILD_SEED}, LAPTOP, STANDING_HZ) as room:
        simulator, desk, dialog = room.simulator, room.desk, room.dialog
        await expect(dialog).to_contain_text(f"focal length {told.fx:.1f}")
        await choose_own_board(dialog)
        await dialog.get_by_role("button", name="Begin").click()
        await expect(dialog.get_by_role("button", name="Finish")).to_be_disabled()
        await hold_everywhere(desk.http, simulator, built.fx / told.fx)
        await dialog.get_by_role("button", name="Finish").click()
        await expect(dialog.locator(".verdict")).to_have_text("This calibration is good.", timeout=600_000)
        await dialog.get_by_role("button", name="Use it").click()
        await expect(dialog).to_contain_text("The robot tells these numbers now")
        fx, fy, cx, cy = (await desk.http.get("/calibration")).json()["camera"]["intrinsics"]
        assert (fx, fy) == pytest.approx((built.fx, built.fy), rel=0.01)
        assert (cx, cy) == pytest.approx((built.cx, built.cy), abs=8.0)
        assert "intrinsics" in (tmp_path / "own" / "calibration.yaml").read_text()


async def test_a_robot_whose_camera_sits_otherwise_is_waved_on_a_phones_page_and_tells_how_it_sits(
    browser: Browser, tmp_path: Path
) -> None:
    built = built_camera(REFERENCE_CAMERA, BuildErrors(**MOUNTED_OTHERWISE))
    async with new_robot_at_the_page(browser, tmp_path, MOUNTED_OTHERWISE, PHONE, WAVED_HZ) as room:
        simulator, desk, dialog = room.simulator, room.desk, room.dialog
        await dialog.get_by_label("What").select_option("camera-imu")
        await choose_own_board(dialog)
        await wave_until_all_is_recorded(dialog, simulator, 1.0, WAVED_S)
        await expect(dialog.locator(".verdict")).to_have_text("This calibration is good.")
        await expect(dialog).to_contain_text("time shift")
        await dialog.get_by_role("button", name="Use it").click()
        await expect(dialog).to_contain_text("The robot tells these numbers now")
        found = (await desk.http.get("/calibration")).json()["camera"]
        T = np.array(found["T_body_cam"])
        turned_deg = np.degrees(np.linalg.norm(so3_log(T[:3, :3].T @ built.T_body_cam_matrix[:3, :3])))
        assert turned_deg < 0.3  # of 3.6 degrees
        assert np.linalg.norm(T[:3, 3] - built.T_body_cam_matrix[:3, 3]) < 0.006  # of 18 mm
        assert found["time_shift_s"] == pytest.approx(built.time_shift_s, abs=5e-4)
        assert found["line_delay_s"] == pytest.approx(built.line_delay_s, abs=2e-6)
        # The board is known from now on, also to a page that is opened anew.
        dialog = await open_dialog(room.page, desk.address)
        await dialog.get_by_role("button", name="Again").click()
        await expect(dialog.get_by_label("What")).to_have_value("camera-imu")
        await expect(dialog.get_by_label("Tag or square, mm")).to_have_value("34.0")


async def test_a_robot_that_was_knocked_is_carried_about_without_a_board_and_tells_how_its_camera_sits_now(
    browser: Browser, tmp_path: Path
) -> None:
    built = built_camera(REFERENCE_CAMERA, BuildErrors(**KNOCKED))
    async with new_robot_at_the_page(browser, tmp_path, KNOCKED, PHONE) as room:
        simulator, desk, dialog = room.simulator, room.desk, room.dialog
        await dialog.get_by_label("What").select_option("check")
        await expect(dialog.get_by_label("Paper")).to_be_hidden()
        await carry_about_until_all_is_recorded(dialog, desk.http, simulator, CARRIED_S)
        verdict = dialog.locator(".verdict")
        await expect(verdict).to_contain_text("The calibration does not fit. “Use it” repairs:")
        await expect(verdict).to_contain_text("rotation")
        await expect(verdict).to_contain_text("time shift")
        await dialog.get_by_role("button", name="Use it").click()
        await expect(dialog).to_contain_text("The robot tells these numbers now")
        found = (await desk.http.get("/calibration")).json()["camera"]
        T = np.array(found["T_body_cam"])
        turned_deg = np.degrees(np.linalg.norm(so3_log(T[:3, :3].T @ built.T_body_cam_matrix[:3, :3])))
        assert turned_deg < 0.5  # of 3.6 degrees
        assert found["time_shift_s"] == pytest.approx(built.time_shift_s, abs=1e-3)  # of 12 ms


async def test_the_wheels_are_driven_in_the_dialog_measured_and_do_as_they_are_told_from_then_on(
    browser: Browser, tmp_path: Path
) -> None:
    async with new_robot_at_the_page(browser, tmp_path, {}, PHONE, STANDING_HZ) as room:
        simulator, desk, dialog = room.simulator, room.desk, room.dialog
        await dialog.get_by_label("What").select_option("wheels")
        await choose_own_board(dialog)
        await drive_until_all_goes_straight(dialog, desk.http, simulator)
        assert await dialog.locator(".verdict.good").count(), await dialog.inner_text()
        await dialog.get_by_role("button", name="Use it").click()
        await expect(dialog).to_contain_text("The robot tells these numbers now")
        wheels = (await desk.http.get("/calibration")).json()["wheels"]
        assert wheels["speed"] == pytest.approx(BodyParameters().linear_efficiency, rel=0.03)
        assert wheels["turn"] < 0.6  # skidding wheels turn a third of what they are told
        await asyncio.to_thread(simulator.ask, cmd="board", gone=True)
        assert await true_turn_rad(desk, simulator, commanded=0.5) == pytest.approx(0.5, rel=0.15)


async def true_turn_rad(desk: Desk, simulator: SimulatorLink, commanded: float) -> float:
    """How far the robot truly turns to the left in a second of so many rad/s."""
    before = np.array((await asyncio.to_thread(simulator.ask, cmd="truth"))["T_world_body"])
    answer = await desk.http.post("/drive", json={"linear": 0.0, "angular": commanded, "ttl_ms": 1000})
    assert answer.status_code == 200, answer.text
    await asyncio.sleep(3.0)  # and the motors' lag
    after = np.array((await asyncio.to_thread(simulator.ask, cmd="truth"))["T_world_body"])
    return float(so3_log(before[:3, :3].T @ after[:3, :3])[2])


async def test_a_minute_at_rest_tells_the_imus_white_noise_and_the_robot_takes_it(
    browser: Browser, tmp_path: Path
) -> None:
    async with new_robot_at_the_page(browser, tmp_path, {}, LAPTOP, UNSEEN_HZ) as room:
        desk, dialog = room.desk, room.dialog
        await dialog.get_by_label("What").select_option("imu")
        await expect(dialog.get_by_label("Paper")).to_be_hidden()
        await dialog.get_by_role("button", name="Begin").click()
        await expect(dialog).to_contain_text("at rest of at least 1 min")
        finish = dialog.get_by_role("button", name="Finish")
        await expect(finish).to_be_disabled()
        await expect(finish).to_be_enabled(timeout=600_000)
        await finish.click()
        await expect(dialog.locator(".verdict")).to_be_visible(timeout=600_000)
        assert await dialog.locator(".verdict.good").count(), await dialog.inner_text()
        await expect(dialog).to_contain_text("gyroscope, white")
        await dialog.get_by_role("button", name="Use it").click()
        await expect(dialog).to_contain_text("The robot tells these numbers now")
        told = (await desk.http.get("/calibration")).json()["imu"]
        assert told["gyro_noise_density"] == pytest.approx(REFERENCE_IMU.gyro_density, rel=0.1)
        assert told["accel_noise_density"] == pytest.approx(REFERENCE_IMU.accel_density, rel=0.1)
