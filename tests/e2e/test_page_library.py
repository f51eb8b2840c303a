"""Navigations and maps on the page: compare, replay, download, delete and undo, a hijack and what follows."""

from __future__ import annotations

import asyncio
import json
import time

import pytest
from playwright.async_api import Page, expect

from station.maps.store import MapStore
from tests.e2e.conftest import Room
from tests.support.link import WAIT_S, until
from tests.support.station import store_map
from tests.support.station_at_work import keep_navigation

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]


async def download(page: Page, link: str) -> bytes:
    async with page.expect_download() as waiting:
        await page.get_by_role("link", name=link, exact=True).click()
    path = await (await waiting.value).path()
    return path.read_bytes()


async def test_record_build_compare_replay_and_download(room: Room) -> None:
    keep_navigation(room.desk.station.config.data_dir, "nav-before")
    room.desk.station.navigations.library.open()
    page = await room.open()
    await page.locator("#record").click()
    await expect(page.locator("#map-count")).to_contain_text("landmarks")
    await page.locator("#record").click()
    recorded = page.locator("#navigations li").first
    await recorded.get_by_role("button", name="Build map").click()
    await expect(page.locator("#place")).to_have_attribute("data-state", "known", timeout=300_000)
    await page.locator("#maps").get_by_role("button", name="More about").click()
    assert (await download(page, "GraphML")).startswith(b"<graphml")
    assert (await download(page, "PLY")).startswith(b"ply")
    await page.locator("#map-dialog").get_by_role("button", name="Rename").click()
    await page.locator("#ask input").fill("Ground floor")
    await page.get_by_role("button", name="Save").click()
    await expect(page.locator("#maps strong")).to_have_text("Ground floor")

    await recorded.get_by_role("button", name="More about").click()
    assert (await download(page, "MCAP")).startswith(b"\x89MCAP")
    assert (await download(page, "PLY")).startswith(b"ply")
    assert len((await download(page, "TUM")).splitlines()) > 10
    await page.get_by_role("checkbox", name="Drive nav-before").check()
    await page.get_by_role("button", name="Compare").click()
    await page.locator("#comparisons").get_by_role("button", name="Show").click(timeout=300_000)
    await expect(page.locator("#review-note")).to_contain_text("places found again")
    await expect(page.locator("[data-registered=true]")).to_have_attribute("aria-pressed", "true")
    await page.locator("[data-registered=false]").click()
    await expect(page.locator("[data-registered=false]")).to_have_attribute("aria-pressed", "true")
    assert b"<!doctype html>" in (await download(page, "Download")).lower()
    [comparison] = (await room.desk.http.get("/comparisons")).json()
    assert comparison["accepted"]

    await recorded.get_by_role("button", name="More about").click()
    await page.get_by_role("button", name="Replay").click()
    await expect(page.locator("#replay-video")).to_be_visible()
    await page.wait_for_function("() => Number(document.getElementById('replay-video').dataset.shown) > 1")
    await expect(page.locator("#review-title")).to_have_text(await recorded.locator("strong").inner_text())
    await expect(page.locator(".age")).not_to_have_class("tag age bad")  # the live picture goes on
    await page.get_by_role("button", name="Close", exact=True).click()
    await expect(page.locator("#review")).to_be_hidden()

    await page.locator("#comparisons").get_by_role("button", name="Delete").click()
    await page.locator("#ask").get_by_role("button", name="Delete").click()
    await expect(page.locator("#comparisons li")).to_have_count(0)
    await recorded.get_by_role("button", name="More about").click()
    await page.locator("#navigation-dialog").get_by_role("button", name="Rename").click()
    await page.locator("#ask input").fill("All rooms, twice around the table and back to the window")
    await page.get_by_role("button", name="Save").click()
    await expect(recorded.locator("strong")).to_have_attribute(
        "title", "All rooms, twice around the table and back to the window"
    )


async def test_navigations_and_maps_are_deleted_and_brought_back(room: Room) -> None:
    data_dir = room.desk.station.config.data_dir
    keep_navigation(data_dir, "nav-before")
    room.desk.station.navigations.library.open()
    place_map = store_map(data_dir)
    page = await room.open()
    await page.get_by_role("button", name="Delete Drive nav-before").click()
    await expect(page.locator("#navigations li")).to_have_count(0)
    await page.locator("#toast").get_by_role("button", name="Undo").click()
    await expect(page.locator("#navigations li")).to_have_count(1)
    await page.get_by_role("button", name=f"Delete {place_map.name}").click()
    await expect(page.locator("#maps li")).to_have_count(0)
    await expect(page.locator("#bin-summary")).to_have_text("Recently deleted (1)")
    await page.reload()
    await page.locator("#bin-summary").click()
    await page.get_by_role("button", name=f"Restore {place_map.name}").click()
    await expect(page.locator("#maps li")).to_have_count(1)
    await expect(page.locator("#bin")).to_be_hidden()
    assert [m.id for m in MapStore(data_dir / "maps").list()] == [place_map.id]


async def test_a_hijack_is_told_and_the_new_place_is_shown(room: Room) -> None:
    place_map = store_map(room.desk.station.config.data_dir)
    first, second = place_map.places[:2]
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": place_map.id})
    await expect(page.locator("#place-name")).to_have_text(first.name)
    await page.locator("#hijack").click()
    await page.get_by_role("radio", name="Put it down at").check()
    for label, value in (("x, m", "2"), ("y, m", "1"), ("heading, degrees", "90")):
        await page.get_by_role("spinbutton", name=label).fill(value)
    await page.locator("#ask button[type=submit]").click()
    await until(lambda: room.bench.head.moved)
    room.film.turn_the_light_out()
    await expect(page.locator("#log [data-topic=hijack]").filter(has_text="was picked up")).to_have_count(1)
    await expect(page.locator("#place-name")).to_have_text(second.name)
    await expect(page.locator("#timeline")).to_have_attribute(
        "aria-label", f"Places visited: {first.name}, {second.name}"
    )
    answer = (await room.desk.http.get("/place/current")).json()
    assert answer["place"]["id"] == second.id, json.dumps(answer)


PAD = """
  window.pad = {connected: true, axes: [0, 0]};
  navigator.getGamepads = () => [window.pad];
"""


async def open_with_gamepad(room: Room) -> Page:
    """The page of somebody who has a gamepad, at rest."""
    page = await room.new_page()
    await page.add_init_script(PAD)
    await room.visit(page)
    await page.bring_to_front()
    return page


async def hold_gamepad(room: Room, page: Page, axes: str = "[0, -1]") -> None:
    """Hold the stick until the motors run. After a halt (a late picture on a busy machine) it must be let go first."""
    deadline = time.monotonic() + WAIT_S
    while not room.motors_run:
        assert time.monotonic() < deadline, "the motors never ran"
        await page.evaluate("pad.axes = [0, 0]")
        await two_ticks(page)
        await page.evaluate(f"pad.axes = {axes}")
        held_until = time.monotonic() + 1.0
        while not room.motors_run and time.monotonic() < held_until:
            await asyncio.sleep(0.02)


async def two_ticks(page: Page) -> None:
    """Until two of the page's driving ticks have read the stick."""
    await page.evaluate("() => new Promise((done) => setTimeout(done, 120))")


async def test_a_gamepad_drives_while_its_stick_is_held(room: Room) -> None:
    page = await open_with_gamepad(room)
    await hold_gamepad(room, page)
    assert room.bench.motors.history[-1][1] > 0
    await page.evaluate("pad.axes = [0.02, 0.03]")  # a stick never rests at exactly nothing
    await until(lambda: room.motors_rest)
    await hold_gamepad(room, page, "[-1, 0]")
    assert room.bench.motors.history[-1][2] > 0
    await page.evaluate("pad.connected = false")
    await until(lambda: room.motors_rest)
    await expect(page.locator("#why")).to_contain_text("the gamepad is gone")


async def test_a_stop_while_the_gamepad_is_held_lasts_until_it_is_let_go(room: Room) -> None:
    page = await open_with_gamepad(room)
    await hold_gamepad(room, page)
    await page.locator("#stop").dispatch_event("click")
    await until(lambda: room.motors_rest)
    stopped, seen = len(room.bench.motors.history), room.film.count
    await until(lambda: room.film.count > seen + 10)
    assert all(entry[1:] == (0.0, 0.0) for entry in room.bench.motors.history[stopped:])
    await page.evaluate("pad.axes = [0, 0]")
    await two_ticks(page)
    await hold_gamepad(room, page)


async def test_the_head_is_pointed_from_the_page(room: Room) -> None:
    page = await room.open()
    await page.locator("#pan").focus()
    await page.keyboard.press("ArrowRight")
    await until(lambda: room.bench.head.pointed and room.bench.head.pointed[-1][0] < 0)
    assert not room.motors_run  # an arrow on a slider moves the slider only


async def test_a_page_that_hangs_stops_the_robot(room: Room) -> None:
    page = await room.open()
    await room.hold(page)
    # Nothing comes from the page any more, and its socket stays open: the station's timer must end it.
    hang = asyncio.ensure_future(page.evaluate("() => { const end = Date.now() + 4000; while (Date.now() < end); }"))
    await until(lambda: room.motors_rest)
    await hang
