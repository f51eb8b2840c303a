"""The page for everybody: axe-core finds nothing, and the keyboard reaches everything."""

from __future__ import annotations

import pytest
from playwright.async_api import Page, expect

from tests.e2e.conftest import LAPTOP, PHONE, Room
from tests.support.link import until
from tests.support.openapi import furnish
from tests.support.page import drive_by_key
from tests.support.paths import ROOT
from tests.support.station import store_map
from tests.support.station_at_work import keep_navigation

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]
AXE = ROOT / "station" / "web" / "node_modules" / "axe-core" / "axe.min.js"


FOCUSED = """() => {
  const e = document.activeElement;
  return [e.id, e.getAttribute('aria-label'), e === document.body ? '' : e.textContent.trim()];
}"""


async def violations(page: Page) -> list[str]:
    """What axe-core finds, a line each."""
    # By the debugger's way in, since the page's policy allows no foreign script.
    await page.evaluate(AXE.read_text())
    found = await page.evaluate("() => axe.run({resultTypes: ['violations']})")
    lines = []
    for violation in found["violations"]:
        where = "; ".join(f"{node['html'][:120]} {node['failureSummary'][:200]}" for node in violation["nodes"][:4])
        lines.append(f"{violation['id']}: {violation['help']}: {where}")
    return lines


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("screen", ["laptop", "phone"])
async def test_axe_finds_nothing(room: Room, theme: str, screen: str) -> None:
    place_map, _ = furnish(room.desk.station.config.data_dir)
    room.desk.station.navigations.library.open()
    page = await room.open(**(PHONE if screen == "phone" else LAPTOP), color_scheme=theme, reduced_motion="reduce")
    await expect(page.locator("html")).to_have_attribute("data-theme", theme)
    assert await violations(page) == []  # no map in use: the guide, empty lists
    await room.desk.http.put("/maps/active", json={"id": place_map.id})
    await expect(page.locator("#place-name")).to_have_text(place_map.places[0].name)
    await room.desk.http.patch(f"/places/{place_map.places[1].id}", json={"hidden": True})
    await expect(page.locator("#hidden")).to_be_visible()
    await room.desk.http.delete("/navigations/nav-1")
    await page.locator("#bin-summary").click()
    await expect(page.locator("#bin-list li")).to_have_count(1)
    assert await violations(page) == []
    for name in DIALOGS:
        await open_dialog(page, name, place_map.places[0].id)
        assert await violations(page) == [], name
        await page.keyboard.press("Escape")
        await expect(page.locator("dialog[open]")).to_have_count(0)
    await room.desk.http.post("/navigations/nav-1/restore")
    await page.locator("#comparisons").get_by_role("button", name="Show").click()
    await expect(page.locator("#review-compare")).to_be_visible()
    assert await violations(page) == [], "comparison"
    await page.get_by_role("button", name="More about Drive nav-2").click()
    await page.get_by_role("button", name="Replay").click()
    await expect(page.locator("#review-replay")).to_be_visible()
    assert await violations(page) == [], "replay"
    await page.get_by_role("button", name="Close", exact=True).click()
    await page.get_by_role("button", name="Delete Drive nav-2").click()
    await expect(page.locator("#toast")).to_be_visible()
    order = {"linear": 0.0, "angular": 0.0, "ttl_ms": 1000}
    await room.desk.http.post("/drive/take-over", headers={"X-Driver": "anna"})
    await room.desk.http.post("/drive", json=order, headers={"X-Driver": "anna"})
    await expect(page.locator("#take-over")).to_be_visible()
    assert await violations(page) == [], "another one drives"
    room.film.pause()
    await expect(page.locator(".age")).to_have_class("tag age bad")
    assert (
        await page.locator(".age").evaluate("e => getComputedStyle(e).color") == "rgb(255, 255, 255)"
    )  # was red on red
    assert await violations(page) == [], "late picture"
    await room.bench.stop()
    await expect(page.locator(".guide .next")).to_contain_text("robot-server --devices simulated")
    assert await violations(page) == [], "no robot"
    await room.bench.start()


DIALOGS = ("place", "rename", "navigation", "map", "name of a map", "comparison", "hijack")


async def open_dialog(page: Page, name: str, place_id: str) -> None:
    """One of DIALOGS."""
    match name:
        case "place" | "rename":
            await page.locator("[data-layer=map]").click()
            await page.locator(f"[data-place='{place_id}']").dispatch_event("click")
            await expect(page.locator("#place-dialog")).to_be_visible()
            if name == "rename":
                await page.locator("#place-dialog").get_by_role("button", name="Rename").click()
        case "navigation":
            await page.get_by_role("button", name="More about Drive nav-2").click()
        case "map" | "name of a map":
            await page.locator("#maps").get_by_role("button", name="More about").click()
            if name != "map":
                await page.locator("#map-dialog").get_by_role("button", name="Rename").click()
        case "comparison":
            await page.locator("#comparisons").get_by_role("button", name="Delete").click()
        case "hijack":
            await page.locator("#hijack").click()
    await expect(page.locator("dialog[open]")).to_have_count(1)


async def test_the_keyboard_reaches_everything_and_works_it(room: Room) -> None:
    data_dir = room.desk.station.config.data_dir
    keep_navigation(data_dir, "nav-1")
    room.desk.station.navigations.library.open()
    place_map = store_map(data_dir)
    await room.desk.http.put("/maps/active", json={"id": place_map.id})
    page = await room.open()
    await expect(page.locator(f"[data-place='{place_map.places[0].id}']")).to_have_count(1)
    reached = await tab_through(page)
    wanted = ["theme", "stick", "speed", "stop", "record", "hijack", "Events", "More about Drive nav-1",
              "Delete Drive nav-1", "3D", "Top", place_map.places[0].name]  # fmt: skip
    assert [name for name in wanted if name not in reached] == []
    assert "pan" in reached  # one may look around also while a map is in use

    await page.get_by_role("button", name="More about Drive nav-1").focus()
    await page.keyboard.press("Enter")
    await expect(page.locator("#navigation-dialog")).to_be_visible()
    await page.keyboard.press("Escape")
    await expect(page.locator("#navigation-dialog")).to_be_hidden()
    # Back where the person was; and a key that means driving does so again.
    assert await page.evaluate("document.activeElement.getAttribute('aria-label')") == "More about Drive nav-1"
    await drive_by_key(page, "w", lambda: room.motors_run)
    await page.keyboard.press("Space")  # STOP, also while a button has the focus
    await until(lambda: room.motors_rest)
    await expect(page.locator("#navigation-dialog")).to_be_hidden()


async def tab_through(page: Page) -> set[str]:
    """Ids and names of everything that Tab stops at, until it comes back to the first."""
    reached: list[str] = []
    for _ in range(80):
        await page.keyboard.press("Tab")
        who = await page.evaluate(FOCUSED)
        reached.extend(filter(None, who))
        if who == ["", None, ""]:
            break
    return set(reached)
