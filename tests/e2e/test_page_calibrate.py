"""The guided calibration on the page, from the board to print to what the robot tells afterwards."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.async_api import Browser, expect

from tests.e2e.conftest import PHONE, Room
from tests.support.board_bench import BUILT, TOLD, before_a_board
from tests.support.station import Film

# More shades than black and its opacity.
IS_DRAWN = "canvas => new Set(canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data).size > 2"

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]


async def test_a_camera_is_calibrated_on_a_phone_used_and_undone(browser: Browser, tmp_path: Path) -> None:
    async with before_a_board(tmp_path) as (desk, bench, showing):
        room = Room(desk, bench, Film(bench), browser)  # the film is not shown
        page = await room.open(**PHONE)
        await page.locator("#calibrate").click()
        dialog = page.locator("#calibrate-dialog")
        await expect(dialog).to_contain_text(f"focal length {TOLD.fx:.1f}")
        assert await dialog.get_by_role("link", name="Board to print").get_attribute("href") == (
            "/calibration/target.pdf?kind=aprilgrid&size=A4"
        )
        picture = dialog.get_by_role("img", name="The live picture")  # its lens is turned sharp before it
        await expect(picture).to_be_visible()
        await page.wait_for_function(IS_DRAWN, arg=await picture.element_handle())
        begin = dialog.get_by_role("button", name="Begin")
        await begin.click()
        ruler = dialog.get_by_label("Its ruler measures")
        await expect(ruler).to_be_focused()  # nothing begins before somebody has measured it
        await ruler.fill("100")
        await begin.click()
        finish = dialog.get_by_role("button", name="Finish")
        await expect(finish).to_be_disabled()
        await showing.show_all(desk)
        await expect(dialog.get_by_role("list", name="How well it is known")).to_contain_text("focal length")
        await expect(finish).to_be_enabled()
        width = await page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert width <= 0, "the page is wider than the phone"
        await finish.click()
        await expect(dialog).to_contain_text("This calibration is good", timeout=300_000)
        await dialog.get_by_role("button", name="Use it").click()
        await expect(dialog).to_contain_text("The robot tells these numbers now")
        told = (await desk.http.get("/calibration")).json()["camera"]["intrinsics"]
        assert told[0] == pytest.approx(BUILT.fx, rel=0.01)
        await dialog.get_by_role("button", name="Next: camera and IMU").click()
        await expect(dialog.get_by_label("What")).to_have_value("camera-imu")
        await dialog.get_by_role("button", name="Begin").click()
        await expect(dialog.get_by_role("list", name="Views")).to_contain_text("roll")
        await dialog.get_by_role("button", name="Give up").click()
        await dialog.get_by_role("button", name="Undo").click()
        await expect(dialog).to_contain_text(f"focal length {TOLD.fx:.1f}")
        assert (await desk.http.get("/calibration")).json()["camera"]["intrinsics"][0] == TOLD.fx


async def test_stop_can_be_pressed_on_a_phone_while_the_dialog_is_open(browser: Browser, tmp_path: Path) -> None:
    async with before_a_board(tmp_path) as (desk, bench, _):
        room = Room(desk, bench, Film(bench), browser)  # the film is not shown
        page = await room.open(**PHONE)
        await page.locator("#calibrate").click()
        dialog = page.locator("#calibrate-dialog")
        stop = dialog.get_by_role("button", name="STOP")
        await dialog.get_by_label("Its ruler measures").fill("100")
        for step in ("Begin", "Give up"):
            await expect(dialog.get_by_role("button", name=step)).to_be_visible()
            await expect(stop).to_be_in_viewport(ratio=1)
            await stop.tap()
            await expect(dialog.locator(".stopping")).to_contain_text("Stopped")
            await dialog.get_by_role("button", name=step).click()
