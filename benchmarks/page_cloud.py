"""Part of bench_page.py: how soon the page shows something, and how it turns a large cloud in software rendering."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator

import numpy as np
from playwright.async_api import Browser, Page

from shared.calibration import Calibration
from station.model.frames import ImageFrame
from station.model.slam_update import SlamUpdate
from tests.support.made_up_workers import StraightSlam

POINTS = 200_000
ORBIT_S = 6.0
STEP_S = 0.016  # of the hand that turns the view
# First paint as the browser tells it; then what a person came for: the place's card filled, the robot's picture.
WATCH_FIRST = """
  window.first = {};
  const note = (what) => { window.first[what] ??= performance.now(); };
  new MutationObserver(() => {
    const place = document.getElementById('place-name');
    if (place && place.textContent !== '…') note('place');
    if (document.querySelector('#video[data-seq]')) note('picture');
    if (document.querySelector('#map-count:not(:empty)')) note('cloud');
  }).observe(document, {subtree: true, childList: true, characterData: true, attributes: true});
"""
PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"
FRAMES = "() => Number(document.getElementById('scene').dataset.frames)"


class LargeCloud(StraightSlam):
    """Sends 200,000 points of four walls and a floor with the first picture, and nothing after."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__(calibration)
        self._random = np.random.default_rng(2)

    def add_frame(self, frame: ImageFrame) -> SlamUpdate:
        update = super().add_frame(frame)
        p = self._random.uniform([-5, -4, 0], [5, 4, 2.5], (POINTS, 3))
        wall = self._random.integers(0, 5, POINTS)
        for number, (axis, value) in enumerate(((0, -5.0), (0, 5.0), (1, -4.0), (1, 4.0), (2, 0.0))):
            p[wall == number, axis] = value
        if len(self.frames) > 1:
            p = p[:0]
        return SlamUpdate(update.t_robot_ns, "tracking", "large", update.T_world_body, POINTS, False, p, np.abs(p) * 40)


async def fresh_pages(browser: Browser, address: str, script: str, repeats: int) -> AsyncIterator[Page]:
    """One after the other, each with an empty cache and with a script that runs before its own."""
    for _ in range(repeats):
        context = await browser.new_context(viewport={"width": 1440, "height": 900})
        page = await context.new_page()
        await page.add_init_script(script)
        await page.goto(address)
        yield page
        await context.close()


async def measure_first_paint(browser: Browser, address: str, repeats: int = 5) -> dict[str, float | None]:
    """Milliseconds after the navigation began, the median of fresh pages with an empty cache."""
    found: dict[str, list[float]] = {"first_contentful_paint": [], "place": [], "picture": [], "cloud": []}
    async for page in fresh_pages(browser, address, WATCH_FIRST, repeats):
        await page.wait_for_selector("#map-count:has-text('landmarks')")
        await page.wait_for_selector("#video[data-seq]")
        found["first_contentful_paint"].append(await page.evaluate(PAINT) or math.nan)
        for name, at in (await page.evaluate("() => window.first")).items():
            found[name].append(at)
    return {f"{name}_ms": round(float(np.median(times)), 1) if times else None for name, times in found.items()}


async def measure_orbit(page: Page) -> dict[str, float]:
    """Redraws a second while a hand turns the 3D view."""
    await page.locator("[data-view=free]").click()
    box = await page.locator("#scene").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down()
    before, begun = await page.evaluate(FRAMES), time.monotonic()
    while (elapsed := time.monotonic() - begun) < ORBIT_S:
        await page.mouse.move(x + 200 * math.sin(elapsed * 2), y + 60 * math.sin(elapsed * 3))
        await asyncio.sleep(STEP_S)
    after, elapsed = await page.evaluate(FRAMES), time.monotonic() - begun
    await page.mouse.up()
    return {"redraws_per_s": round((after - before) / elapsed, 1), "seconds": round(elapsed, 1)}
