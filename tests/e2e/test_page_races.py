"""Answers that come late must not undo what the page was told since."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from urllib.parse import urlsplit

import pytest
from playwright.async_api import Page, Route, expect

from station.maps.store import MapStore
from station.model.place_map import PlaceMap
from tests.e2e.conftest import Room
from tests.support.station import store_map

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]


LISTS = ("/maps", "/navigations", "/log", "/place/timeline")
COUNT_CALLS = """
  window.callsUnderWay = 0;
  const original = window.fetch;
  window.fetch = (...given) => {
    window.callsUnderWay += 1;
    return original(...given).finally(() => (window.callsUnderWay -= 1));
  };
"""
QUIET = """() => { window.quiet = window.callsUnderWay ? 0 : (window.quiet ?? 0) + 1; return window.quiet > 5; }"""


class Held:
    """The first answers to some GETs: the station gave them at once, the page gets them when told."""

    def __init__(self, *paths: str) -> None:
        self._missing = set(paths)
        self._told = asyncio.Event()
        self._all = asyncio.Event()

    async def open(self, page: Page) -> None:
        await page.add_init_script(COUNT_CALLS)
        await page.route(lambda url: urlsplit(url).path in self._missing, self._take)

    async def answered(self) -> None:
        await self._all.wait()

    async def _take(self, route: Route) -> None:
        path = urlsplit(route.request.url).path
        if path not in self._missing or route.request.method != "GET":
            await route.continue_()
            return
        response = await route.fetch()
        self._missing.discard(path)
        if not self._missing:
            self._all.set()
        await self._told.wait()
        await route.fulfill(response=response)

    async def let_go(self, page: Page) -> None:
        """Hand the answers out, and wait until whatever they lead to has happened."""
        self._told.set()
        await page.wait_for_function(QUIET)


def _second_map(room: Room, first: PlaceMap) -> PlaceMap:
    places = tuple(replace(place, id=f"other-{place.id}", name=f"Other {place.name}") for place in first.places)
    edges = tuple(replace(edge, a=f"other-{edge.a}", b=f"other-{edge.b}") for edge in first.edges)
    second = replace(first, id="other-map", name="Other room", places=places, edges=edges)
    MapStore(room.desk.station.config.data_dir / "maps").save(second)
    return second


async def test_late_first_answers_do_not_undo_the_choice_of_a_map(room: Room) -> None:
    place_map = store_map(room.desk.station.config.data_dir)
    late = Held(*LISTS)
    page = await room.new_page()
    await late.open(page)
    await page.goto(room.desk.address)
    await late.answered()  # the station said: no map is active
    await room.desk.http.put("/maps/active", json={"id": place_map.id})
    await expect(page.locator("#place-name")).to_have_text(place_map.places[0].name)
    await late.let_go(page)
    await expect(page.locator(f"[data-place='{place_map.places[0].id}']")).to_have_count(1)
    await expect(page.locator("#maps .in-use")).to_contain_text(place_map.name)
    await expect(page.locator("#log")).to_contain_text(f"using {place_map.name}")
    await expect(page.locator("#timeline")).to_have_attribute(
        "aria-label", f"Places visited: {place_map.places[0].name}"
    )


async def test_the_graph_of_a_map_left_since_is_not_shown(room: Room) -> None:
    first = store_map(room.desk.station.config.data_dir)
    second = _second_map(room, first)
    late = Held("/graph")
    page = await room.new_page()
    await late.open(page)
    await page.goto(room.desk.address)
    await page.wait_for_selector("#link[data-state=good]")
    await room.desk.http.put("/maps/active", json={"id": first.id})
    await late.answered()
    await room.desk.http.put("/maps/active", json={"id": second.id})
    await expect(page.locator("#place-name")).to_have_text(second.places[0].name)
    await late.let_go(page)
    await expect(page.locator(f"[data-place='{second.places[0].id}']")).to_have_count(1)
    await expect(page.locator(f"[data-place='{first.places[0].id}']")).to_have_count(0)
    await expect(page.locator(f"[data-place='{second.places[0].id}']")).to_have_count(1)


async def test_a_late_list_of_navigations_does_not_hide_one_that_began_since(room: Room) -> None:
    late = Held("/navigations")
    page = await room.new_page()
    await late.open(page)
    await page.goto(room.desk.address)
    await late.answered()  # the station said: there is no navigation
    navigation = (await room.desk.http.post("/navigations", json={"name": "Kitchen and back"})).json()
    await expect(page.locator("#rec")).to_be_visible()
    await room.desk.http.post(f"/navigations/{navigation['id']}/stop")
    await expect(page.locator("#navigations")).to_contain_text("Kitchen and back")
    await late.let_go(page)
    await expect(page.locator("#navigations")).to_contain_text("Kitchen and back")
