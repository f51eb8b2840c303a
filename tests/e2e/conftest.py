"""Chromium and the built page; where one of them is missing, the browser tests are skipped with a sentence."""

from __future__ import annotations

import asyncio
import importlib.util
import re
import shutil
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Browser, BrowserContext, Page, async_playwright, expect

from tests.support.link import Bench, running_robot, until
from tests.support.paths import ROOT
from tests.support.station import Desk, Film, running_station

CHROMIUM = next(filter(None, (shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome"))), None)
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
YOU_DRIVE = re.compile("^You drive")  # and "slowed to 60 %", where the machine that tests is busy
LAPTOP = {"viewport": {"width": 1440, "height": 900}}
expect.set_options(timeout=90_000)  # a loaded machine; only a failing test waits so long
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


@pytest.fixture(scope="session")
def page_is_built() -> None:
    """Build the page from its sources, or skip."""
    if CHROMIUM is None:
        pytest.skip("browser tests need Chromium: apt-get install chromium")
    spec = importlib.util.spec_from_file_location("build_hook", ROOT / "station" / "web" / "build_hook.py")
    assert spec is not None and spec.loader is not None
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    try:
        hook.build()
    except hook.PageNotBuilt as exc:
        pytest.skip(f"browser tests need the built page: {exc}")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def browser(page_is_built: None) -> AsyncIterator[Browser]:
    async with async_playwright() as playwright:
        chromium = await playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        try:
            yield chromium
        finally:
            await chromium.close()


@dataclass
class Room:
    """A robot, a station and a browser."""

    desk: Desk
    bench: Bench
    film: Film
    browser: Browser
    contexts: list[BrowserContext] = field(default_factory=list)

    @property
    def motors_run(self) -> bool:
        return bool(self.bench.motors.history) and not self.bench.motors.are_off

    @property
    def motors_rest(self) -> bool:
        return bool(self.bench.motors.history) and self.bench.motors.are_off

    async def open(self, **options: Any) -> Page:
        """A page of its own browser profile, with live video."""
        page = await self.new_page(**options)
        await self.visit(page)
        return page

    async def visit(self, page: Page) -> None:
        """Open the station's page and wait until it shows live video."""
        await page.goto(self.desk.address)
        await page.wait_for_selector("#video[data-seq]")
        await page.wait_for_selector("#link[data-state=good]")
        await page.wait_for_selector(".age:not(.bad)")

    async def new_page(self, **options: Any) -> Page:
        """A blank page of its own browser profile. Requests to other hosts fail the test."""
        context = await self.browser.new_context(**(options or LAPTOP))
        self.contexts.append(context)
        page = await context.new_page()
        page.set_default_timeout(90_000)
        page.on("request", lambda request: self._check(request.url))
        return page

    def _check(self, url: str) -> None:
        own = self.desk.address.removeprefix("http")
        assert url.startswith(("http" + own, "ws" + own, "blob:", "data:")), f"the page asked another host: {url}"

    async def hold(self, page: Page) -> None:
        """Push the joystick forward until the motors run; as a person does, press anew when the page let go of it.

        A busy machine makes pictures late, and the page stops for late pictures, as it should.
        """
        box = await page.locator("#stick").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        held = page.locator("#stick.held")
        while True:
            await page.wait_for_selector(".age:not(.bad)")
            await page.mouse.move(x, y)
            await page.mouse.down()
            await page.mouse.move(x, y - 60, steps=3)
            while await held.count() and not self.motors_run:
                await asyncio.sleep(0.02)
            if self.motors_run:
                return
            await page.mouse.up()


@pytest_asyncio.fixture(loop_scope="module")
async def room(browser: Browser, tmp_path: Path) -> AsyncIterator[Room]:
    async with furnished(browser, tmp_path, running_robot) as room:
        yield room


@asynccontextmanager
async def furnished(
    browser: Browser, data_dir: Path, robot: Callable[[], AbstractAsyncContextManager[Bench]]
) -> AsyncIterator[Room]:
    async with robot() as bench, running_station(bench.port, data_dir) as desk:
        film = Film(bench)
        filming = asyncio.create_task(film.run())
        room = Room(desk, bench, film, browser)
        try:
            await until(lambda: desk.station.first.state.connected and desk.station.first.camera.newest)
            yield room
        finally:
            for context in room.contexts:
                await context.close()
            filming.cancel()
            await asyncio.gather(filming, return_exceptions=True)
