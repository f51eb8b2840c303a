"""What the page must not do: lose a click, go elsewhere by itself, drive blind, or say what is not so."""

from __future__ import annotations

import os
import re
import signal
from typing import Literal

import pytest
from playwright.async_api import Page, expect

from tests.e2e.conftest import PHONE, YOU_DRIVE, Room
from tests.e2e.test_page_library import hold_gamepad, open_with_gamepad
from tests.support.link import until
from tests.support.openapi import furnish
from tests.support.station import store_map
from tests.support.station_at_work import keep_navigation

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]


async def box(page: Page, selector: str) -> tuple[float, float, float, float]:
    """Left, top, right, bottom."""
    found = await page.locator(selector).first.bounding_box()
    assert found is not None, f"{selector} is not on the screen"
    return found["x"], found["y"], found["x"] + found["width"], found["y"] + found["height"]


async def keep(room: Room, name: str) -> None:
    keep_navigation(room.desk.station.config.data_dir, name)
    room.desk.station.navigations.library.open()


COUNT_FRAMES = """() => {
    const ask = window.requestAnimationFrame;
    window.framesAsked = 0;
    window.requestAnimationFrame = (draw) => { window.framesAsked += 1; return ask.call(window, draw); };
}"""
IS_OLDER_THAN_S = """seconds =>
    Number(/^([0-9.]+) s old$/.exec(document.getElementById("age").textContent)?.[1]) > seconds"""


async def test_nothing_is_drawn_while_nothing_changes(room: Room) -> None:
    """Also with the calibration's dialog open, which shows each picture once."""
    page = await room.open()
    await page.locator("#calibrate").click()
    await expect(page.locator("#calibrate-dialog")).to_be_visible()
    room.film.pause()
    await page.wait_for_function(IS_OLDER_THAN_S, arg=1, polling=100)
    await page.evaluate(COUNT_FRAMES)
    await page.wait_for_function(IS_OLDER_THAN_S, arg=3, polling=100)
    assert await page.evaluate("window.framesAsked") < 20  # of some 120 that a screen shows


async def test_rows_stay_the_same_buttons_while_what_they_tell_of_changes(room: Room) -> None:
    await keep(room, "nav-before")
    page = await room.open()
    more = page.get_by_role("button", name="More about Drive nav-before")
    await more.focus()
    button = await more.element_handle()
    assert button is not None and await button.evaluate("e => e === document.activeElement")
    await room.desk.http.post("/navigations")
    await expect(page.locator("#record .text")).to_contain_text(re.compile(r"· \d+:(?!00|01)\d\d"))  # told every second
    await room.desk.http.patch("/navigations/nav-before", json={"name": "All rooms"})
    await expect(page.locator("#navigations strong")).to_have_text("All rooms")
    assert await button.evaluate("e => e === document.activeElement")
    left, top, right, bottom = await box(page, "#record .text")
    assert bottom - top < 30 and right - left > 100  # its label in one line
    await button.click()
    await expect(page.locator("#navigation-dialog h2")).to_have_text("All rooms")


async def test_the_map_stays_in_sight_while_a_navigation_grows_and_is_finished(room: Room) -> None:
    place_map = store_map(room.desk.station.config.data_dir)
    await room.desk.http.put("/maps/active", json={"id": place_map.id})
    page = await room.open()
    await expect(page.locator("#map-count")).to_contain_text("places")
    navigation = (await room.desk.http.post("/navigations")).json()["id"]
    await expect(page.locator("#slam")).to_have_text("going straight")
    recording = room.desk.station.first.current_navigation
    await until(lambda: recording.live is not None and len(recording.live.points) > 100)
    await expect(page.locator("[data-layer=map]")).to_have_attribute("aria-pressed", "true")
    await page.locator("[data-layer=live]").click()
    grown = re.compile(r"\d,\d\d\d landmarks")
    await expect(page.locator("#map-count")).to_have_text(grown)
    await expect(page.locator("#scene")).to_have_attribute("data-whole", "true")  # although each picture adds to it
    await page.locator("[data-layer=map]").click()
    await room.desk.http.post(f"/navigations/{navigation}/stop")
    await expect(page.get_by_role("button", name="Build map")).to_be_visible()
    await expect(page.locator("[data-layer=map]")).to_have_attribute("aria-pressed", "true")


CUT = """() => {
  const scene = document.getElementById('scene').getBoundingClientRect();
  const names = [...document.querySelectorAll('.place-label:not(.dot)')].filter((e) => e.style.display !== 'none');
  const boxes = names.map((e) => e.getBoundingClientRect());
  return boxes.filter((b) => b.top < scene.top - 1 || b.bottom > scene.bottom + 1).length;
}"""


async def test_no_name_of_a_place_is_cut_at_the_edge_of_the_view(room: Room) -> None:
    place_map = store_map(room.desk.station.config.data_dir)
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": place_map.id})
    await expect(page.locator("#place-name")).to_have_text(place_map.places[0].name)
    await expect(page.locator(".place-label")).to_have_count(len(place_map.places))
    left, top, right, bottom = await box(page, "#scene")
    x, y = (left + right) / 2, bottom - 40
    await page.mouse.move(x, y)
    await page.mouse.down(button="right")
    for step in range(12):  # past the upper edge, name by name
        drawn = int(await page.locator("#scene").get_attribute("data-frames") or 0)
        await page.mouse.move(x, y - (step + 1) * (bottom - top) / 20)
        await page.wait_for_function(
            "(drawn) => Number(document.getElementById('scene').dataset.frames) > drawn", arg=drawn
        )
        assert await page.evaluate(CUT) == 0
    await page.mouse.up(button="right")


async def test_what_slam_has_left_to_do_is_told_and_can_be_given_up(room: Room) -> None:
    page = await room.open()
    await page.locator("#record").click()
    await expect(page.locator("#slam")).to_have_text("going straight")
    pid = room.desk.station.first.current_navigation.slam_pid
    assert pid is not None and pid != os.getpid()
    os.kill(pid, signal.SIGSTOP)  # a busy machine
    await page.locator("#record").click()
    await expect(page.locator("#slam")).to_contain_text("finishing:")
    await expect(page.locator("#navigations .finishing .note")).to_contain_text("finishing:")
    await expect(page.locator(".guide .next")).to_contain_text("SLAM finishes it")
    await page.get_by_role("button", name="Cancel finishing").click()
    await page.locator("#ask").get_by_role("button", name="Cancel finishing").click()
    await expect(page.locator("#navigations .failed .note")).to_contain_text("SLAM was cancelled")
    await expect(page.locator("#slam")).to_be_empty()


@pytest.mark.parametrize("width", [900, 1100, 1280])
async def test_a_laptop_has_room_for_the_head_too(room: Room, width: int) -> None:
    page = await room.open(viewport={"width": width, "height": 800})
    for slider in ("#pan", "#tilt"):
        left, _, right, _ = await box(page, slider)
        assert right - left > 110, f"{slider} is {right - left:.0f} px wide"


async def test_a_phone_has_room_for_the_head_and_for_whole_sentences(room: Room) -> None:
    page = await room.open(**PHONE)
    for slider in ("#pan", "#tilt", "#speed"):
        left, _, right, _ = await box(page, slider)
        assert right - left > 110, f"{slider} is {right - left:.0f} px wide"
    for part in ("#driver", "#place-reason"):
        whole = await page.locator(part).evaluate(
            "e => e.scrollWidth <= e.clientWidth + 1 && e.scrollHeight <= e.clientHeight + 3"
        )
        assert whole, f"{part} is cut: {await page.locator(part).inner_text()}"
    for part in ("#video", "#stick", "#stop", "#pan"):
        assert (await box(page, part))[3] <= 844, f"{part} is out of sight"


async def test_a_refused_name_stays_in_its_dialog_with_the_reason(room: Room) -> None:
    place_map = store_map(room.desk.station.config.data_dir)
    first, second = place_map.places[:2]
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": place_map.id})
    await page.locator(f"[data-place='{first.id}']").dispatch_event("click")
    await expect(page.get_by_role("button", name="Merge")).to_be_disabled()  # with nobody knows which
    await expect(page.get_by_label("Same place as")).to_have_value("")
    stops = room.bench.stops_heard
    await page.get_by_label("Same place as").focus()
    await page.keyboard.press("Space")  # is STOP, and opens no list; the arrows choose
    await until(lambda: room.bench.stops_heard > stops)
    await page.get_by_role("button", name="Rename").click()
    await page.locator("#ask input").fill(second.name)
    await page.get_by_role("button", name="Save").click()
    await expect(page.locator("#ask [role=alert]")).to_contain_text("another place named")
    await page.locator("#ask input").fill("Reading corner")
    await page.keyboard.press("Enter")
    await expect(page.locator("#ask")).to_be_hidden()
    await expect(page.locator("#place-name")).to_have_text("Reading corner")
    await expect(page.locator("#toast")).to_be_visible()
    bottom = (await box(page, "#toast"))[3]
    for part in ("#place", ".map-bar"):
        assert bottom <= (await box(page, part))[1], f"{part} is covered"
    await expect(page.locator("#evidence-text")).to_contain_text("landmarks of the map seen where they belong")
    await room.bench.stop()
    await expect(page.locator("#evidence-text")).to_contain_text("does not tell where the robot is now")
    await room.bench.start()


async def test_nothing_drives_behind_a_dialog_and_space_stops_there_too(room: Room) -> None:
    await keep(room, "nav-1")
    await keep(room, "nav-2")
    page = await open_with_gamepad(room)
    await hold_gamepad(room, page)
    await page.get_by_role("button", name="More about Drive nav-1").dispatch_event("click")
    await until(lambda: room.motors_rest)
    await expect(page.locator("#why")).to_contain_text("a dialog is open")
    stops = room.bench.stops_heard
    await page.locator("#navigation-dialog").get_by_role("button", name="Close").focus()
    await page.keyboard.press("Space")
    await until(lambda: room.bench.stops_heard > stops)
    await expect(page.locator("#navigation-dialog")).to_be_visible()
    await page.get_by_role("checkbox", name="Drive nav-2").focus()
    await page.keyboard.press("Space")
    await expect(page.get_by_role("checkbox", name="Drive nav-2")).to_be_checked()
    await page.locator("#navigation-dialog").get_by_role("button", name="Rename").click()
    await page.locator("#ask input").fill("")
    await page.keyboard.type("Two words")
    await page.keyboard.press("Enter")
    await expect(page.locator("#navigations")).to_contain_text("Two words")


async def test_a_page_that_never_got_a_picture_does_not_drive(room: Room) -> None:
    page = await room.new_page()
    await page.route_web_socket(re.compile("/ws/camera"), lambda _: None)  # opens, and nothing comes
    await page.goto(room.desk.address)
    await page.wait_for_selector("#link[data-state=good]")
    await page.keyboard.down("w")
    await expect(page.locator("#why")).to_contain_text("no picture of the robot has come yet")
    assert not any(linear or angular for _, linear, angular in room.bench.motors.history)


async def test_a_stop_arrives_also_where_the_socket_is_dead_and_nobody_was_told(room: Room) -> None:
    page = await room.new_page()
    await page.route_web_socket(re.compile("/ws/drive"), lambda _: None)  # takes everything, and hands nothing on
    await page.goto(room.desk.address)
    await page.wait_for_selector("#link[data-state=good]")
    stops = room.bench.stops_heard
    await page.keyboard.press("Space")
    await until(lambda: room.bench.stops_heard > stops)


async def test_a_page_that_does_not_drive_stops_nobody_by_what_keeps_it_from_driving(room: Room) -> None:
    await keep(room, "nav-1")
    page = await open_with_gamepad(room)
    await page.get_by_role("button", name="More about Drive nav-1").click()
    await page.evaluate("pad.axes = [0, -1]")
    await expect(page.locator("#why")).to_contain_text("a dialog is open")
    await page.keyboard.press("Space")  # sent after whatever was sent before, and told
    await expect(page.locator("#log")).to_contain_text("stopped: STOP key")
    assert not [line for line in room.desk.station.first.events.log if "a dialog is open" in line.text]


async def test_a_hand_on_the_joystick_is_no_more_in_a_list(room: Room) -> None:
    page = await room.open()
    await page.locator("#robots").evaluate("e => { e.hidden = false; e.focus(); }")  # as with two robots
    await expect(page.locator("#robots")).to_be_focused()
    left, top, right, bottom = await box(page, "#stick")
    await page.mouse.move((left + right) / 2, (top + bottom) / 2)
    await page.mouse.down()
    await expect(page.locator("#robots")).not_to_be_focused()
    await page.mouse.up()


async def test_the_page_is_dressed_as_the_system_is_until_a_person_chooses(room: Room) -> None:
    page = await room.new_page()
    dress = page.locator("html")
    themes: tuple[Literal["dark", "light"], ...] = ("dark", "light")
    for theme in themes:
        await page.emulate_media(color_scheme=theme)
        await page.goto(room.desk.address)
        await expect(dress).to_have_attribute("data-theme", theme)
    await page.emulate_media(color_scheme="dark")  # at dusk, while the page is open
    await expect(dress).to_have_attribute("data-theme", "dark")
    await page.locator("#theme").click()
    await expect(dress).to_have_attribute("data-theme", "light")
    await page.reload()
    await expect(dress).to_have_attribute("data-theme", "light")


async def test_the_address_of_a_robot_that_is_gone_leads_to_those_that_are_there(room: Room) -> None:
    page = await room.new_page()
    await page.goto(f"{room.desk.address}/?robot=attic")
    await expect(page.locator("#ask")).to_contain_text("no robot “attic”")
    await page.locator("#ask a").click()
    await page.wait_for_selector("#link[data-state=good]")
    assert "robot=attic" not in page.url


# A first random number of its own for each tab: two tabs may have one name, once in a while.
NAMES = """
  const tab = Number(localStorage.getItem('tabs') ?? 0) + 1;
  localStorage.setItem('tabs', String(tab));
  const random = Math.random;
  Math.random = () => { Math.random = random; return tab / 10; };
"""


async def test_a_duplicated_tab_is_another_driver_and_a_reloaded_one_the_same(room: Room) -> None:
    page = await room.new_page()
    await page.context.add_init_script(NAMES)
    await room.visit(page)
    async with page.context.expect_page() as opening:
        await page.evaluate("() => { window.open(location.href); }")  # with a copy of what the tab keeps
    copy = await opening.value
    await copy.wait_for_selector("#link[data-state=good]")
    await page.bring_to_front()
    await room.hold(page)
    await expect(page.locator("#driver")).to_have_text(YOU_DRIVE)
    await expect(copy.locator("#driver")).to_have_text(re.compile(r"\d+ drives"))
    name = (await room.desk.http.get("/robot")).json()["driver"]
    await page.mouse.up()
    await until(lambda: room.motors_rest)
    await room.visit(page)
    await room.hold(page)
    assert (await room.desk.http.get("/robot")).json()["driver"] == name
    await page.mouse.up()


PROGRAMS = """
  window.programs = 0;
  for (const [name, change] of [['createProgram', 1], ['deleteProgram', -1]]) {
    const original = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...given) {
      window.programs += change;
      return original.apply(this, given);
    };
  }
"""


async def test_what_was_looked_at_again_is_given_back_to_the_graphics_card(room: Room) -> None:
    furnish(room.desk.station.config.data_dir)
    room.desk.station.navigations.library.open()
    page = await room.new_page()
    await page.add_init_script(PROGRAMS)
    await room.visit(page)
    await page.wait_for_function("() => window.programs > 0")
    before = await page.evaluate("window.programs")
    await page.locator("#comparisons").get_by_role("button", name="Show").click()
    await page.wait_for_function("(before) => window.programs > before", arg=before)
    await page.locator("#review-close").click()
    await page.wait_for_function("(before) => window.programs <= before", arg=before)
    await room.desk.http.delete("/navigations/nav-1")
    await expect(page.locator("#bin-list .note")).to_have_text(re.compile(r"gone for good on \d+ [A-Z][a-z]{2} 20\d\d"))
