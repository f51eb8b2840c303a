"""The floor plan on the page: seen first, rooms are named by clicking into them, and it is taken back."""

from __future__ import annotations

import asyncio
import json
import re
from dataclasses import replace

import pytest
from playwright.async_api import Page, Route, WebSocketRoute, expect

from station.maps.store import MapStore
from station.model.place_map import PlaceMap
from station.places.rooms.edits import require_plan
from tests.e2e.conftest import Room
from tests.support.station import store_planned_map, store_split_map

HALL = "Hall where the coats and shoes are"
pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]


async def test_a_room_is_named_by_clicking_into_it_and_by_a_suggestion(room: Room) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await expect(page.locator("[data-layer=plan]")).to_have_attribute("aria-pressed", "true")
    await expect(page.locator(".plan-room")).to_have_count(2)

    async def answer_when_the_plan_is_drawn_anew(route: Route) -> None:
        if route.request.method == "PATCH":
            answer = await route.fetch()
            await expect(page.locator(".plan-names text[data-room=room-l]")).to_have_text("Lounge")
            await route.fulfill(response=answer)
        else:
            await route.continue_()

    await page.route(re.compile("/rooms/room-l$"), answer_when_the_plan_is_drawn_anew)
    await page.locator(".plan-room[data-room=room-l]").press("Enter")
    await page.locator("#room-name").fill("Lounge")
    await page.keyboard.press("Enter")
    await expect(page.locator(".plan-names text[data-room=room-l]")).to_have_text("Lounge")
    await expect(page.locator(".plan-room[data-room=room-l]")).to_be_focused()  # in the new drawing, too
    await page.locator(".plan-room[data-room=room-k]").press("Enter")
    await expect(page.locator("#room-dialog .suggestions .source")).to_have_text("sticker · 98 %")
    await page.locator("#room-dialog").get_by_role("button", name="Use it").click()
    await expect(page.locator(".plan-names text[data-room=room-k]")).to_have_text("Kitchen")
    await expect(page.locator("#toast")).to_contain_text("Kitchen")  # no more of the change before
    await page.locator("#toast").get_by_role("button", name="Undo").click()
    await expect(page.locator(".plan-names text[data-room=room-k]")).to_have_text("Room 2")
    assert await page.locator(".place-label").count() == 0  # nobody would see those of the 3D view
    await page.locator("[data-layer=map]").click()
    await expect(page.locator("#plan")).to_be_hidden()
    await expect(page.locator(".place-label")).to_have_count(len(planned.places))


async def test_a_name_that_was_removed_is_given_back(room: Room) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await room.desk.http.patch("/rooms/room-k", json={"name": "Pantry"})
    label = page.locator(".plan-names text[data-room=room-k]")
    for way in ("button", "empty field"):
        await expect(label).to_have_text("Pantry")
        await page.locator(".plan-room[data-room=room-k]").press("Enter")
        if way == "button":
            await page.locator("#room-dialog").get_by_role("button", name="Remove name").click()
        else:
            await page.locator("#room-name").fill("")
            await page.keyboard.press("Enter")
        await expect(label).to_have_text("Room 2")
        await expect(page.locator("#toast")).to_contain_text("Pantry has no name any more.")
        await page.locator("#toast").get_by_role("button", name="Undo").click()
    await expect(label).to_have_text("Pantry")


@pytest.mark.parametrize(("ending", "begin"), [("SVG", b"<svg"), ("PNG", b"\x89PNG")])
async def test_the_plan_is_downloaded_as_a_drawing(room: Room, ending: str, begin: bytes) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await expect(page.locator(".plan-room")).to_have_count(2)
    async with page.expect_download() as waiting:
        await page.locator("#plan").get_by_role("link", name=ending).click()
    download = await waiting.value
    assert download.suggested_filename == f"{planned.id}.{ending.lower()}"
    assert (await download.path()).read_bytes().startswith(begin)


async def open_split(room: Room) -> tuple[PlaceMap, Page]:
    """A map of two rooms in use, and the page that shows it."""
    split = store_split_map(room.desk.station.config.data_dir)
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": split.id})
    return split, page


async def test_while_rooms_are_made_one_the_page_says_that_the_plan_is_made_anew(room: Room) -> None:
    _, page = await open_split(room)
    await expect(page.locator(".plan-room")).to_have_count(2)

    async def answer_when_it_was_said(route: Route) -> None:
        await expect(page.locator("#toast")).to_have_text("The plan is made anew …")
        await route.continue_()

    await page.route(re.compile("/rooms/merge$"), answer_when_it_was_said)
    await page.locator(".plan-room").first.press("Enter")
    await page.locator("#one-room-with").select_option(index=1)
    await page.locator("#room-dialog").get_by_role("button", name="Merge").click()
    await expect(page.locator(".plan-room")).to_have_count(1)
    await expect(page.locator("#toast").get_by_role("button", name="Undo")).to_be_visible()


async def test_undo_that_is_pressed_before_a_door_is_erased_takes_the_erasing_back(room: Room) -> None:
    split, page = await open_split(room)
    first = require_plan(split).rooms[0].id
    await room.desk.http.patch(f"/rooms/{first}", json={"name": HALL})
    await expect(page.locator("#undo-text")).to_contain_text(f"is {HALL} now")
    button = await page.locator("#undo-places").bounding_box()
    assert button is not None and button["height"] < 40  # its word is in one line, however long the change is

    async def erase_when_undo_was_pressed(route: Route) -> None:
        await page.locator("#undo-places").click()
        await expect(page.locator("#undo-text")).to_contain_text("as soon as")
        await route.continue_()

    await page.route(re.compile("/doors/"), erase_when_undo_was_pressed)
    await page.locator(".plan-door").first.press("Enter")
    await page.locator("#toast").get_by_role("button", name="Erase").click()
    await expect(page.locator("#toast")).to_contain_text("Taken back: the door between")
    await expect(page.locator(".plan-room")).to_have_count(2)
    await expect(page.locator(f".plan-room[data-room={first}]")).to_have_attribute(
        "aria-label", HALL
    )  # that change stays
    await expect(page.locator("#undo-text")).to_contain_text(f"is {HALL} now")


async def test_undo_that_is_pressed_before_a_door_is_erased_leaves_what_somebody_else_made_since(room: Room) -> None:
    _, page = await open_split(room)
    await expect(page.locator(".plan-room")).to_have_count(2)

    async def answer_when_another_change_was_made(route: Route) -> None:
        await page.locator("#undo-places").click()
        answer = await route.fetch()
        kept = (await room.desk.http.get("/rooms")).json()[0]["id"]
        await room.desk.http.patch(f"/rooms/{kept}", json={"name": HALL})  # by somebody else
        await route.fulfill(response=answer)

    await page.route(re.compile("/doors/"), answer_when_another_change_was_made)
    await page.locator(".plan-door").first.press("Enter")
    await page.locator("#toast").get_by_role("button", name="Erase").click()
    await expect(page.locator("#toast")).to_contain_text(re.compile(f"^Meanwhile: .* is {HALL} now"))
    assert [one["name"] for one in (await room.desk.http.get("/rooms")).json()] == [HALL]


async def test_undo_while_the_list_of_changes_lags_behind_asks_about_the_newest_one(room: Room) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    page = await room.open()
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await room.desk.http.patch("/rooms/room-l", json={"name": "Hall"})
    await expect(page.locator("#undo-text")).to_contain_text("is Hall now")
    is_pressed = asyncio.Event()

    async def lag_behind(route: Route) -> None:
        await is_pressed.wait()
        await route.continue_()

    await page.route(re.compile("/places/changes$"), lag_behind)
    await room.desk.http.patch("/rooms/room-k", json={"name": "Kitchen"})  # by somebody else
    await expect(page.locator(".plan-names [data-room=room-k]")).to_have_text("Kitchen")
    async with page.expect_response(re.compile("/places/undo$")):
        await page.locator("#undo-places").click()
    is_pressed.set()
    await expect(page.locator("#toast")).to_contain_text("Meanwhile: Room 2 is Kitchen now.")
    await page.locator("#toast").get_by_role("button", name="Undo").click()
    await expect(page.locator(".plan-names [data-room=room-k]")).to_have_text("Room 2")
    await expect(page.locator("#undo-text")).to_contain_text("is Hall now")


async def test_of_two_rooms_that_look_alike_both_are_named_each_with_its_probability(room: Room) -> None:
    planned = store_planned_map(room.desk.station.config.data_dir)
    two = [{"id": "room-l", "name": "Bedroom", "probability": 0.52}]
    two += [{"id": "room-k", "name": "Bedroom 2", "probability": 0.46}]

    def between_rooms(socket: WebSocketRoute) -> None:
        """The station's words, with another answer to where the robot is."""
        station = socket.connect_to_server()

        def pass_on(message: str | bytes) -> None:
            told = json.loads(message)
            if told["type"] == "place":
                told["place"] |= {"state": "lost", "place": None, "distance_m": None, "room": None, "doorway": None}
                told["place"] |= {"room_alternatives": two, "one_of_two": two}
            socket.send(json.dumps(told))

        station.on_message(pass_on)

    page = await room.new_page()
    await page.route_web_socket(re.compile("/ws/events"), between_rooms)
    await page.goto(room.desk.address)
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await expect(page.locator("#place-name")).to_have_text("Bedroom or Bedroom 2")
    await expect(page.locator("#place-at")).to_have_text("52 % or 46 %")
    await expect(page.locator("#place-kicker")).to_have_text("One of two rooms")
    await expect(page.locator("#place-probability")).to_have_text("")


async def test_undo_takes_back_nothing_of_another_map_that_is_in_use_by_then(room: Room) -> None:
    """Each map counts its own versions: that change has the same."""
    split, page = await open_split(room)
    other = replace(split, id=f"{split.id}-2")
    MapStore(room.desk.station.config.data_dir / "maps").save(other)
    await page.locator(".plan-door").first.press("Enter")
    await page.locator("#toast").get_by_role("button", name="Erase").click()
    undo = page.locator("#toast").get_by_role("button", name="Undo")
    await expect(undo).to_be_visible()
    await room.desk.http.put("/maps/active", json={"id": other.id})
    await room.desk.http.patch(f"/rooms/{require_plan(other).rooms[0].id}", json={"name": HALL})
    await expect(page.locator("#undo-text")).to_contain_text(f"is {HALL} now")
    await undo.click()
    await expect(page.locator("#toast")).to_contain_text("of another map")
    assert (await room.desk.http.get("/rooms")).json()[0]["name"] == HALL
