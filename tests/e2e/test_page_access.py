"""The page of a station with access control: log in by token or link, watch without driving, be thrown out."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio
from playwright.async_api import Browser, Page, expect

from shared.access import Role
from shared.token_book import TokenBook
from tests.e2e.conftest import LAPTOP
from tests.e2e.test_page_for_everybody import violations
from tests.support.access import Guarded, guarded_station
from tests.support.link import Bench, running_robot, until
from tests.support.page import drive_by_key
from tests.support.station import Film

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(loop_scope="module")
async def house(browser: Browser, tmp_path: Path) -> AsyncIterator[tuple[Guarded, Bench, Page]]:
    async with running_robot() as bench, guarded_station(tmp_path, bench.port) as station:
        filming = asyncio.create_task(Film(bench).run())
        context = await browser.new_context(**LAPTOP, ignore_https_errors=True)  # a person compares the fingerprint
        page = await context.new_page()
        page.set_default_timeout(90_000)
        try:
            await until(lambda: station.desk.station.first.state.connected and station.desk.station.first.camera.newest)
            yield station, bench, page
        finally:
            await context.close()
            filming.cancel()
            await asyncio.gather(filming, return_exceptions=True)


async def test_a_watcher_logs_in_sees_stops_and_cannot_drive(house: tuple[Guarded, Bench, Page]) -> None:
    station, bench, page = house
    await page.emulate_media(color_scheme="light")
    await page.goto(station.desk.address)
    await page.get_by_label("Token").fill("nonsense")
    await expect(page.locator("html")).to_have_attribute("data-theme", "light")  # before anybody has logged in
    field = await page.get_by_label("Token").bounding_box()
    assert field is not None and field["width"] > 300
    await page.get_by_role("button", name="Log in").click()
    await expect(page.get_by_role("alert").filter(has_text="not valid")).to_be_visible()
    for theme in ("dark", "light"):
        await page.evaluate("theme => { document.documentElement.dataset.theme = theme; }", theme)
        assert await violations(page) == []
    await page.get_by_label("Token").fill(station.tokens[Role.WATCH])
    await page.get_by_role("button", name="Log in").click()
    await page.wait_for_selector("#video[data-seq]")
    await expect(page.locator("#logout")).to_have_attribute("title", "watcher, watch")
    await page.keyboard.down("w")
    await expect(page.locator("#why")).to_contain_text("may only watch")
    await page.keyboard.up("w")
    assert not bench.stops_heard
    await page.get_by_role("button", name="STOP").click()
    await until(lambda: bench.stops_heard)
    assert all(told[1:] == (0.0, 0.0) for told in bench.motors.history)
    assert not await page.evaluate("document.cookie")  # scripts do not see it
    await page.reload()
    await page.wait_for_selector("#video[data-seq]")  # the cookie is enough
    TokenBook(station.folder).revoke("watcher", time.time())
    await expect(page.get_by_label("Token")).to_be_visible()  # thrown out, and asked anew


async def test_a_link_lets_one_browser_in_once(house: tuple[Guarded, Bench, Page]) -> None:
    station, bench, page = house
    book = TokenBook(station.folder)
    owner = book.find(station.tokens[Role.DRIVE], time.time())
    assert owner is not None
    link = f"{station.desk.address}/#login={book.add_for(owner, 'link', time.time(), 600.0).text}"
    await page.goto(link)
    await page.wait_for_selector("#video[data-seq]")
    assert "login" not in page.url
    await drive_by_key(page, "w", lambda: bench.motors.history and not bench.motors.are_off)
    await page.keyboard.up("w")
    await page.get_by_role("button", name="Log out").click()
    await expect(page.get_by_label("Token")).to_be_visible()
    await page.goto("about:blank")
    await page.goto(link)
    await expect(page.get_by_role("alert").filter(has_text="not valid")).to_be_visible()
