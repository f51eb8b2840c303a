"""How far the next thing ahead is, beside the joystick."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from playwright.async_api import Browser, expect

from robot.devices.pi.hc_sr04 import calibration_of
from robot.devices.ports import CapturedDepth
from shared.pictures import depth_png
from tests.e2e.conftest import PHONE, Room, furnished
from tests.support.depth_robot import DepthBench, FakeDepth, running_robot_with_depth

pytestmark = pytest.mark.asyncio(loop_scope="module")
SONAR = calibration_of((0.2, 0.0, 0.0))
PERIOD_S = 0.1


class Wall:
    """Something before the sensor, measured ten times a second."""

    def __init__(self, sensor: FakeDepth) -> None:
        self._sensor = sensor
        self.millimetres: int | None = 820  # None: the sensor is silent

    async def stand(self) -> None:
        number = 0
        while True:
            if self.millimetres is not None:
                picture = depth_png(np.array([[self.millimetres]], dtype=np.uint16))
                self._sensor.pictures.put_nowait(CapturedDepth(number, picture))
                number += 1
            await asyncio.sleep(PERIOD_S)


async def test_the_distance_ahead_is_said_in_words(browser: Browser, tmp_path: Path) -> None:
    async with furnished(browser, tmp_path, partial(running_robot_with_depth, SONAR)) as room:
        assert isinstance(room.bench, DepthBench)
        wall = Wall(room.bench.depth)
        standing = asyncio.create_task(wall.stand())
        try:
            for page in (await room.open(), await room.open(**PHONE)):
                said = page.locator("#ahead")
                for millimetres, text, near in (
                    (820, "82 cm to the next thing ahead", "false"),
                    (2440, "2.4 m to the next thing ahead", "false"),
                    (310, "31 cm to the next thing ahead", "true"),
                    (0, "Nothing measured ahead", "false"),
                    (None, "Distance ahead unknown", "false"),
                ):
                    wall.millimetres = millimetres
                    await expect(said).to_have_text(text)
                    await expect(said).to_have_attribute("data-near", near)
                box, stick = await said.bounding_box(), await page.locator("#stick").bounding_box()
                assert box is not None and stick is not None
                assert box["x"] >= stick["x"] + stick["width"] and box["y"] < stick["y"] + stick["height"]
        finally:
            standing.cancel()


async def test_a_robot_without_a_sensor_says_nothing_of_it(room: Room) -> None:
    page = await room.open()
    await expect(page.locator("#linear")).to_be_visible()
    await expect(page.locator("#ahead")).to_be_hidden()
