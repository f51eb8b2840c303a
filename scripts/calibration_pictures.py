"""Takes the pictures of docs/calibration.md: python scripts/calibration_pictures.py [OUT]

A simulated robot with another camera than it tells, a station, and the page in headless Chromium, on a phone and on a
laptop. A script holds the simulated board, waves the robot and drives it, as in tests/e2e/test_new_robot.py. Takes some
minutes; do it on a quiet machine. OUT: docs/images by default. Where it has a folder `steps`, every step goes in there.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.async_api import Browser, Locator, Page, async_playwright, expect

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scripts.page_pictures import SCREENS  # noqa: E402
from tests.support.new_robot import (  # noqa: E402
    HELD,
    choose_own_board,
    drive_as_told,
    hold,
    hold_everywhere,
    new_robot,
    open_dialog,
    stand_in_the_open,
    wave_until_all_is_recorded,
)
from tests.support.station import running_station  # noqa: E402

BUILT = {"focal_percent": -6.0, "pitch_deg": 3.0, "yaw_deg": -2.0, "forward_cm": 1.5, "time_shift_ms": 12.0}
IN_DOCS = ("camera-begin", "camera-look", "camera-result", "camera-imu-look", "camera-imu-result", "wheels-look")
WITHOUT_3D = ["--no-sandbox", "--disable-gpu"]  # software would draw it, and leave the simulated camera no time
WIDTH_PX, COLOURS = 720, 128


class Photographer:
    """Takes each step on two screens that show the same session."""

    def __init__(self, pages: dict[str, Page], out: Path) -> None:
        self._pages, self._out = pages, out

    async def take(self, step: str) -> None:
        for screen, page in self._pages.items():
            dialog = page.locator("#calibrate-dialog")
            if not await dialog.is_visible():
                await page.locator("#calibrate").click()
            await page.wait_for_timeout(1000)  # for what is drawn a few times a second
            steps = self._out / "steps"
            if steps.is_dir():
                await page.screenshot(path=steps / f"calibrate-{step}-{screen}.png")
            if screen == "laptop" and step in IN_DOCS:
                path = self._out / f"calibrate-{step}.png"
                await dialog.screenshot(path=path)
                shrink(path)


def shrink(path: Path) -> None:
    """As wide as docs need it, and with few colours: a photograph of a room is large as PNG."""
    with Image.open(path) as taken:
        image = taken.convert("RGB")
    image.thumbnail((WIDTH_PX, 2 * WIDTH_PX), Image.Resampling.LANCZOS)
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


async def go_through(browser: Browser, out: Path, folder: Path) -> None:
    async with new_robot(folder, BUILT) as (port, simulator), running_station(port, folder / "station") as desk:
        screens = SCREENS if (out / "steps").is_dir() else {"laptop": SCREENS["laptop"]}
        pages = {name: await browser.new_page(**options, color_scheme="dark") for name, options in screens.items()}
        dialogs = {name: await open_dialog(page, desk.address) for name, page in pages.items()}
        photographer, dialog = Photographer(pages, out), dialogs["laptop"]
        await photographer.take("camera-begin")
        await choose_own_board(dialog)
        await press(dialog, "Begin")
        await stand_in_the_open(desk.http, simulator, 1.0)
        for place in HELD[: len(HELD) // 2]:
            await hold(desk.http, simulator, 1.0, place)
        await photographer.take("camera-look")
        await hold_everywhere(desk.http, simulator, 1.0)
        await press(dialog, "Finish")
        await expect(dialog.locator(".verdict")).to_be_visible(timeout=300_000)
        await photographer.take("camera-result")
        await press(dialog, "Use it")
        await photographer.take("camera-used")
        await press(dialog, "Next")
        await photographer.take("camera-imu-begin")
        waving = asyncio.create_task(wave_until_all_is_recorded(dialog, simulator, 1.0, 30.0))
        while not any(
            s["seen"] for s in (await desk.http.get("/calibration/sessions")).json() if s["kind"] != "camera"
        ):
            await asyncio.sleep(0.2)
        await asyncio.sleep(10.0)
        await photographer.take("camera-imu-look")
        await waving
        await photographer.take("camera-imu-result")
        await press(dialog, "Use it")
        await press(dialog, "Next")
        await photographer.take("wheels-begin")
        await press(dialog, "Begin")
        await stand_in_the_open(desk.http, simulator, 1.0)
        await photographer.take("wheels-look")
        await drive_as_told(dialog)
        await press(dialog, "Finish")
        await expect(dialog.locator(".verdict")).to_be_visible(timeout=300_000)
        await photographer.take("wheels-result")
        await press(dialog, "Use it")
        await press(dialog, "Next")
        await photographer.take("imu-begin")
        await press(dialog, "Begin")
        await asyncio.sleep(15.0)
        await photographer.take("imu-rest")
        await press(dialog, "Give up")


async def press(dialog: Locator, name: str) -> None:
    await dialog.get_by_role("button", name=name).click()


async def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "images"
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=shutil.which("chromium"), args=WITHOUT_3D)
        with tempfile.TemporaryDirectory(prefix="calibration-pictures-") as folder:
            await go_through(browser, out, Path(folder))
        await browser.close()


if __name__ == "__main__":
    asyncio.run(main())
