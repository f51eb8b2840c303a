"""The floor plan on the page: seen first, rooms are named by clicking into them, and it is taken back."""

from __future__ import annotations

import pytest
from playwright.async_api import expect

from tests.e2e.conftest import Room
from tests.support.station import store_planned_map

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]


async def test_a_room_is_named_by_clicking_into_it_and_by_a_suggestion(room: Room) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await expect(page.locator("[data-layer=plan]")).to_have_attribute("aria-pressed", "true")
    await expect(page.locator(".plan-room")).to_have_count(2)
    await page.locator(".plan-room[data-room=room-l]").press("Enter")
    await page.locator("#room-name").fill("Lounge")
    await page.keyboard.press("Enter")
    await expect(page.locator(".plan-names text[data-room=room-l]")).to_have_text("Lounge")
    await expect(page.locator(".plan-room[data-room=room-l]")).to_be_focused()  # in the new drawing, too
    await page.locator(".plan-room[data-room=room-k]").press("Enter")
    await expect(page.locator("#room-dialog .suggestions .source")).to_have_text("sticker · 98 %")
    await page.locator("#room-dialog").get_by_role("button", name="Use it").click()
    await expect(page.locator(".plan-names text[data-room=room-k]")).to_have_text("Kitchen")
    await page.locator("#toast").get_by_role("button", name="Undo").click()
    await expect(page.locator(".plan-names text[data-room=room-k]")).to_have_text("Room 2")
    assert await page.locator(".place-label").count() == 0  # nobody would see those of the 3D view
    await page.locator("[data-layer=map]").click()
    await expect(page.locator("#plan")).to_be_hidden()
    await expect(page.locator(".place-label")).to_have_count(len(planned.places))
