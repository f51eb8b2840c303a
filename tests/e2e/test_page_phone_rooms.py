"""A flat's rooms are named on a phone: press, type, done; nothing is too small, cut off, or under the keyboard."""

from __future__ import annotations

import numpy as np
import pytest
from playwright.async_api import Page, expect

from station.maps.store import MapStore
from station.places.making.build import build_map
from station.places.rooms.edits import with_room_split
from station.places.rooms.planning import planned
from tests.e2e.conftest import Room
from tests.support.made_up_workers import made_up_navigation
from tests.support.station import DRAWN, store_planned_map

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]
SMALL_PHONE = {"viewport": {"width": 375, "height": 667}, "has_touch": True, "is_mobile": True}
KEYBOARD = 0.5  # share of the screen that a phone's keyboard may cover
FINGER_PX = 44
NAMES = ("Hall", "Kitchen", "Bath")
ACROSS = np.array([[-1.0, 2.0], [2.0, 2.0]])  # parts the smaller half of the room that DRAWN makes two of
SIZES = """selector => [...document.querySelectorAll(selector)].map((e) => {
  const box = e.getBoundingClientRect();
  return [e.textContent.trim() || e.id, box.width, box.height, box.bottom];
}).filter(([, width]) => width)"""


async def test_the_rooms_of_a_flat_are_named_on_a_phone(room: Room) -> None:
    flat = with_room_split(planned(build_map(made_up_navigation(), name="Flat")), DRAWN)
    flat = with_room_split(flat, ACROSS)
    assert flat.plan is not None and len(flat.plan.rooms) == len(NAMES)
    MapStore(room.desk.station.config.data_dir / "maps").save(flat)
    page = await room.open(**SMALL_PHONE)
    await room.desk.http.put("/maps/active", json={"id": flat.id})
    await expect(page.locator(".plan-room")).to_have_count(len(NAMES))
    await page.locator(".map").evaluate("e => e.scrollIntoView({block: 'start'})")
    box = await page.locator("#plan").bounding_box()
    assert box is not None and box["x"] >= 0 and box["x"] + box["width"] <= 375 and box["y"] + box["height"] <= 667
    await expect(page.locator("#name-hint")).to_be_visible()
    await reachable(page, ".map-bar button")
    await reachable(page, ".plan-files a")
    for drawn, name in zip(flat.plan.rooms, NAMES, strict=True):
        label = page.locator(f".plan-names [data-room='{drawn.id}']")
        await label.tap()
        await expect(page.locator("#room-name")).to_be_focused()
        await expect(page.locator("#room-dialog .note").first).to_contain_text("door")
        await reachable(page, "#room-dialog :is(button, input, select)")
        bottom = max(row[3] for row in await page.evaluate(SIZES, "#room-dialog .naming > *"))
        assert bottom < KEYBOARD * 667, "the keyboard covers the field or its button"
        await page.keyboard.type(name)
        await page.locator("#room-dialog").get_by_role("button", name="Save").tap()
        await expect(label).to_have_text(name)
        await expect(page.locator("#toast")).to_contain_text(name)  # it comes when the dialog has closed
        await reachable(page, "#toast button")
    await expect(page.locator("#name-hint")).to_be_hidden()
    assert await page.evaluate("document.documentElement.scrollWidth") == 375


async def test_a_phone_puts_the_pen_away_by_a_button_that_the_page_tells_of(room: Room) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    page = await room.open(**SMALL_PHONE)
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await page.get_by_role("button", name="Draw a door").tap()
    await expect(page.locator("#plan svg.drawing")).to_be_visible()
    await expect(page.locator("#pen-hint")).to_contain_text("Cancel")
    await page.locator("#plan .plan-room").first.tap(force=True)  # too short for a line, and no room is opened either
    await expect(page.locator("#plan svg.drawing")).to_be_visible()
    assert await page.locator("dialog[open]").count() == 0
    await reachable(page, ".map-bar button")
    await page.locator(".map-bar").get_by_role("button", name="Cancel").tap()
    await expect(page.locator("#pen-hint")).to_be_hidden()
    assert await page.locator("#plan svg.drawing").count() == 0
    await expect(page.get_by_role("button", name="Draw a door")).to_be_visible()


SUGGESTED = """() => [...document.querySelectorAll('.suggestions li')].map((li) => {
  const box = (selector) => li.querySelector(selector).getBoundingClientRect();
  const [name, source, note] = [box('strong'), box('.source'), box('.note')];
  const isBelow = source.top >= name.bottom - 1;
  return [isBelow ? source.left - name.left : 0, note.width / li.getBoundingClientRect().width];
})"""


async def test_suggested_names_leave_their_sentences_the_width_of_a_phone(room: Room) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    page = await room.open(**SMALL_PHONE)
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await page.locator(".plan-room[data-room=room-k]").press("Enter")
    await expect(page.locator(".suggestions img")).to_be_visible()
    [(indent, share)] = await page.evaluate(SUGGESTED)
    assert indent == 0 and share > 0.9
    await reachable(page, ".suggestions button")


async def reachable(page: Page, selector: str) -> None:
    """As large as a finger, and their letters so large that a phone does not zoom to them."""
    sizes = await page.evaluate(SIZES, selector)
    assert sizes and [row for row in sizes if min(row[1], row[2]) < FINGER_PX] == []
    fonts = await page.locator("dialog[open] :is(input, select)").evaluate_all(
        "all => all.map(e => parseFloat(getComputedStyle(e).fontSize))"
    )
    assert min(fonts, default=16) >= 16
