"""What the page says of room, place and position: nothing that contradicts itself, and STOP stays where it is."""

from __future__ import annotations

import json
import re
from typing import Any, cast

import pytest
from playwright.async_api import FloatRect, Page, WebSocketRoute, expect

from tests.e2e.conftest import LAPTOP, Room
from tests.support.link import until
from tests.support.station import store_planned_map

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]
SMALL_PHONE = {"viewport": {"width": 375, "height": 667}, "has_touch": True, "is_mobile": True}
LONG = "The room with the blue curtains where grandmother keeps everything that we need."
LIVING_ROOM = {"id": "room-l", "name": "Living room", "probability": 0.93}
CHILD = {"id": "room-k", "name": "Child's room", "probability": 0.9}
Told = dict[str, Any]
SOFA = {"id": "place-1", "name": "Sofa"}
AT_SOFA: Told = {"place": SOFA, "place_room": "room-l", "place_elsewhere": False}
OF_VISIT = ("place", "place_room", "place_elsewhere", "room")


async def planned_page(room: Room, told: Told, **options: Any) -> Page:
    """The page of a map with two rooms; each of the station's answers says `told` instead, as it is by then."""

    def say(socket: WebSocketRoute) -> None:
        station = socket.connect_to_server()

        def pass_on(message: str | bytes) -> None:
            event = json.loads(message)
            if event["type"] == "place" and event["place"]["t_robot_ns"] is not None:
                event["place"] |= told
                if event["visit"]:
                    event["visit"] |= {name: told[name] for name in OF_VISIT if name in told}
            socket.send(json.dumps(event))

        station.on_message(pass_on)

    page = await room.new_page(**options)
    await page.route_web_socket(re.compile("/ws/events"), say)
    await room.visit(page)
    planned = store_planned_map(room.desk.station.config.data_dir)
    await room.desk.http.put("/maps/active", json={"id": planned.id})
    await expect(page.locator(".plan-room")).to_have_count(2)
    return page


def place_of(name: str, room_id: str | None) -> Told:
    """Near it, in the living room."""
    is_elsewhere = room_id not in (None, "room-l")
    return {"place": {"id": "place-1", "name": name}, "place_room": room_id, "place_elsewhere": is_elsewhere}


async def test_a_place_of_another_room_is_told_by_the_door_or_not_at_all(room: Room) -> None:
    told: Told = {"room": LIVING_ROOM} | place_of("Child's room · door to Living room", "room-k")
    page = await planned_page(room, told)
    name, below, kicker = (page.locator(selector) for selector in ("#place-name", "#place-at", "#place-kicker"))
    await expect(name).to_have_text("Living room")
    await expect(below).to_have_text("near the door to Child's room")
    await expect(kicker).to_have_text("Current room")
    await expect(page.locator("#timeline")).to_have_attribute("aria-label", re.compile("near the door to Child's room"))
    for place in ("Child's room · door to Workshop", "Child's room · 2", "Teddy"):
        told |= place_of(place, "room-k")
        await expect(below).to_be_hidden()
        told |= place_of("Sofa", "room-l")
        await expect(below).to_have_text("Sofa, 90 %")
        await expect(kicker).to_have_text(re.compile("^Current room and place"))
    told |= place_of("Place 3", None)  # of no room of the plan
    await expect(below).to_have_text("Place 3, 90 %")
    told |= place_of("Child's room · 2", "room-k") | {"doorway": "door-lk", "room_alternatives": [CHILD]}
    await expect(name).to_have_text("Living room / Child's room")
    await expect(below).to_have_text("Child's room · 2, 90 %")
    told |= {"place": None, "state": "lost", "doorway": None}
    await expect(below).to_have_text("not sure at which place")


async def test_each_probability_says_of_what_it_is_and_why_some_are_more_than_all(room: Room) -> None:
    other = {"id": "place-2", "name": "Shelf", "probability": 0.08, "map": "map-1"}
    told: Told = {"room": LIVING_ROOM, **AT_SOFA, "probability": 0.91, "alternatives": [other]}
    page = await planned_page(room, told)
    await expect(page.locator("#place-probability")).to_have_text("93 %")
    await expect(page.locator("#place-probability-of")).to_have_text("room")
    await expect(page.locator("#else-title")).to_have_text("Perhaps as near")
    told["alternatives"] = [other | {"probability": 0.62}]
    await expect(page.locator("#else-title")).to_contain_text("together more than 100 %")
    told |= {"room": None}
    await expect(page.locator("#place-probability")).to_have_text("91 %")
    await expect(page.locator("#place-probability-of")).to_have_text("place")
    told |= {"place": None, "state": "lost"}
    await expect(page.locator("#else-title")).to_have_text("Nearest place, perhaps")
    await expect(page.locator("#place-probability-of")).to_have_text("")


async def test_what_an_answer_withholds_is_not_shown_as_sure(room: Room) -> None:
    other = {"id": "place-2", "name": "Shelf", "probability": 0.97, "map": "map-1"}
    seen: Told = {"room": LIVING_ROOM, **AT_SOFA, "alternatives": [other], "withheld": False}
    told = dict(seen)
    page = await planned_page(room, told)
    await expect(page.locator(".plan-robot.known .body")).to_have_count(1)
    await expect(page.locator("#else")).to_be_visible()
    told |= {"state": "unknown", "place": None, "room": None, "withheld": True}
    await expect(page.locator(".plan-robot.withheld .around")).to_have_count(1)
    assert await page.locator(".plan-robot :is(.body, .heading)").count() == 0
    await expect(page.locator(".plan-robot")).to_have_text("?")
    await expect(page.locator("#else")).to_be_hidden()
    await expect(page.locator("#place-probability")).to_have_text("")
    told |= {"state": "known"} | seen
    await expect(page.locator(".plan-robot.known .body")).to_have_count(1)


IS_CUT = "id => { const e = document.getElementById(id); return e.scrollHeight > e.clientHeight + 1; }"
SAID: dict[str, Told] = {
    "a room and a place": {**AT_SOFA},
    "no place": {"place": None, "state": "lost"},
    "a doorway": {"doorway": "door-lk", "room_alternatives": [CHILD]},
    "long names": {
        "room": LIVING_ROOM | {"name": LONG},
        **AT_SOFA,
        "place": SOFA | {"name": LONG},
        "reason": f"{LONG} {LONG} {LONG}",
    },
    "a word without a blank": {"room": LIVING_ROOM | {"name": 80 * "m"}, **AT_SOFA, "place": SOFA | {"name": 80 * "m"}},
    "nothing": {"room": None, "place": None, "state": "unknown", "alternatives": [], "reason": ""},
    "a map that is read": {"room": None, "place": None, "state": "lost", "preparing": 0.3, "t_robot_ns": None},
    "one of two": {"room": None, "place": None, "state": "lost", "one_of_two": [LIVING_ROOM, CHILD]},
}
WHERE = """() => ["stick", "stop", "video"].map((id) => {
  const { x, y, width, height } = document.getElementById(id).getBoundingClientRect();
  return [x, y, width, height].map(Math.round);
})"""


@pytest.mark.parametrize("options", [SMALL_PHONE, LAPTOP], ids=["phone", "laptop"])
async def test_joystick_and_stop_stay_where_they_are_whatever_the_card_says(room: Room, options: Told) -> None:
    first: Told = {"room": LIVING_ROOM, **AT_SOFA, "reason": "first"}
    told = dict(first)
    page = await planned_page(room, told, **options)
    found = {}
    for number, (what, said) in enumerate(SAID.items()):
        reason = said.get("reason") or f"{number}"
        told |= {"state": "known", "one_of_two": [], "doorway": None, "preparing": None} | first | said
        told["reason"] = reason
        await expect(page.locator("#place-reason")).to_have_text(reason)
        found[what] = (await page.evaluate(WHERE))[: 3 if options is SMALL_PHONE else 2]
        assert await page.evaluate("document.documentElement.scrollWidth") == options["viewport"]["width"]
    assert all(where == found["no place"] for where in found.values()), found


async def test_a_tap_on_a_phone_shows_what_is_cut_and_moves_nothing(room: Room) -> None:
    told: Told = {"room": LIVING_ROOM | {"name": LONG}, **AT_SOFA, "reason": f"{LONG} {LONG} {LONG}"}
    page = await planned_page(room, told, **SMALL_PHONE)
    await expect(page.locator("#place-name")).to_have_text(LONG)
    before = await page.evaluate(WHERE)
    assert await page.evaluate(IS_CUT, "place-reason")
    await page.locator("#place").tap()
    for text in ("place-name", "place-at-name", "place-reason"):
        assert not await page.evaluate(IS_CUT, text)
    assert await page.evaluate(WHERE) == before
    await page.locator("#place").tap()
    assert await page.evaluate(IS_CUT, "place-reason")


async def test_the_keyboard_shows_what_is_cut_and_space_stays_stop(room: Room) -> None:
    told: Told = {"room": LIVING_ROOM | {"name": LONG}, **AT_SOFA, "reason": f"{LONG} {LONG} {LONG}"}
    page = await planned_page(room, told, **SMALL_PHONE)
    await expect(page.locator("#place-name")).to_have_text(LONG)
    card = page.get_by_role("button", name="Whole answer")
    while await page.evaluate("document.activeElement.id") != "place-whole":
        await page.keyboard.press("Tab")
    await expect(card).to_have_attribute("aria-expanded", "false")
    for is_whole in ("true", "false"):
        await page.keyboard.press("Enter")
        await expect(card).to_have_attribute("aria-expanded", is_whole)
        assert await page.evaluate(IS_CUT, "place-reason") == (is_whole == "false")
    stops = room.bench.stops_heard
    await page.keyboard.press("Space")
    await until(lambda: room.bench.stops_heard > stops)
    await expect(card).to_have_attribute("aria-expanded", "false")


async def test_a_name_of_eighty_letters_stays_in_its_room_and_is_whole_beside_the_pointer(room: Room) -> None:
    page = await planned_page(room, {"room": LIVING_ROOM | {"name": LONG}, **AT_SOFA})
    assert (await room.desk.http.patch("/rooms/room-l", json={"name": LONG})).status_code == 200
    label = page.locator(".plan-names [data-room=room-l]")
    await expect(label).to_have_text(re.compile("^The room.*…$"))
    await expect(label).to_have_class(re.compile("here"))
    drawn_room = page.locator(".plan-room[data-room=room-l]")
    written, drawn = [cast(FloatRect, await shown.bounding_box()) for shown in (label, drawn_room)]
    assert drawn["x"] <= written["x"] and written["x"] + written["width"] <= drawn["x"] + drawn["width"]
    await page.locator(".plan-room[data-room=room-l]").hover(position={"x": 10, "y": 10})
    await expect(page.locator(".plan-room[data-room=room-l] title")).to_have_text(LONG)
    await expect(page.locator("#place-name")).to_have_attribute("title", LONG)
    box = await page.locator("#place-name").bounding_box()
    assert box is not None and box["height"] < 110  # two lines
