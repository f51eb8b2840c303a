"""Part of bench_page.py: how soon a page shows the plan of a home of 1000 rooms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from playwright.async_api import Browser

from benchmarks.page_cloud import fresh_pages
from shared.geometry import FloatArray
from station.maps.store import MapStore
from station.model.floor_plan import FREE, NO_ROOM, UNSEEN, Door, FloorPlan, Room
from station.model.place_map import PlaceMap
from tests.support.places import make_map

COLUMNS, ROWS = 40, 25
ROOM_M, WALL_M, DOOR_M, CELL_M = (4.0, 3.0), 0.1, 0.9, 0.1
PLACES = ((0.5, 0.5), (0.25, 0.3), (0.75, 0.7))  # of each room, as shares of its sides
# From the moment the page asks for its plan until the picture with all rooms has been drawn.
WATCH_PLAN = """
  new MutationObserver((_, observer) => {
    if (!document.querySelector('.plan-names')) return;
    observer.disconnect();
    requestAnimationFrame(() => setTimeout(() => { window.planDrawn = performance.now(); }));
  }).observe(document, {subtree: true, childList: true});
"""
PLAN_TIMES = """() => {
  const asked = performance.getEntriesByType('resource').filter((e) => e.name.endsWith('/floorplan'));
  const [first] = asked;
  return {rooms: document.querySelectorAll('.plan-room').length, read_ms: first.responseEnd - first.startTime,
          drawn_ms: window.planDrawn - first.startTime};
}"""


def store_large_home(data_dir: Path) -> PlaceMap:
    """A map with a plan of COLUMNS by ROWS rooms, each with a door to the next, in a station's store."""
    base = make_map(places=1)
    step = np.array(ROOM_M) + WALL_M
    corners = np.array([(i, j) for j in range(ROWS) for i in range(COLUMNS)]) * step
    rooms = tuple(
        Room(f"room-{k}", f"Room {k + 1}", ROOM_M[0] * ROOM_M[1], corner + np.array(ROOM_M) / 2)
        for k, corner in enumerate(corners)
    )
    cells = np.round(np.array(ROOM_M) / CELL_M).astype(int)
    room = np.full(np.round(np.array([COLUMNS, ROWS]) * step / CELL_M).astype(int), NO_ROOM, dtype=np.int16)
    for k, (x, y) in enumerate(np.round(corners / CELL_M).astype(int)):
        room[x : x + cells[0], y : y + cells[1]] = k
    places = {
        replace(
            base.places[0], id=f"{room.id}-{n}", name=f"{room.name} · {n}", centroid_map=np.append(at, 0.5)
        ): room.id
        for room, corner in zip(rooms, corners, strict=True)
        for n, at in enumerate(corner + np.array(PLACES) * ROOM_M, start=1)
    }
    plan = FloorPlan(
        R_ground_map=np.eye(3),
        low=np.zeros(2),
        cell=CELL_M,
        unit=1.0,
        state=np.where(room == NO_ROOM, UNSEEN, FREE).astype(np.uint8),
        room=room,
        rooms=rooms,
        doors=tuple(_doors(corners)),
        walls=np.concatenate([_walls(corner) for corner in corners]),
        room_of_place={place.id: room_id for place, room_id in places.items()},
    )
    place_map = replace(base, name="A thousand rooms", places=tuple(places), plan=plan)
    MapStore(data_dir / "maps").save(place_map)
    return place_map


def _doors(corners: FloatArray) -> list[Door]:
    """From each room to the next in its row, and from the first of each row to the next row."""
    doors = []
    for k, (x, y) in enumerate(corners):
        if (k + 1) % COLUMNS:
            ends = np.array([[x + ROOM_M[0], y + 1.0], [x + ROOM_M[0], y + 1.0 + DOOR_M]])
            doors.append(Door(f"door-{k}-x", (f"room-{k}", f"room-{k + 1}"), ends))
        if k % COLUMNS == 0 and k + COLUMNS < len(corners):
            ends = np.array([[x + 1.0, y + ROOM_M[1]], [x + 1.0 + DOOR_M, y + ROOM_M[1]]])
            doors.append(Door(f"door-{k}-y", (f"room-{k}", f"room-{k + COLUMNS}"), ends))
    return doors


def _walls(corner: FloatArray) -> FloatArray:
    """(4, 2, 2)"""
    around = corner + np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * ROOM_M
    return np.stack([around, np.roll(around, -1, axis=0)], axis=1)


async def measure_plan(browser: Browser, address: str, repeats: int = 5) -> dict[str, float]:
    """Milliseconds, the median of fresh pages; and how many rooms were drawn."""
    found = []
    async for page in fresh_pages(browser, address, WATCH_PLAN, repeats):
        await page.wait_for_function("() => window.planDrawn")
        found.append(await page.evaluate(PLAN_TIMES))
    return {name: float(np.median([times[name] for times in found])) for name in found[0]}
