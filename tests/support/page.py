"""What a person does at the page, for browser tests."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from playwright.async_api import Page

from tests.support.link import WAIT_S

ANEW_S = 3.0  # a person whose robot does not move lets go by then, and tries again


async def drive_by_key(page: Page, key: str, is_driving: Callable[[], object]) -> None:
    """Hold a key until the robot drives; press anew when the page let go of it.

    A busy machine makes pictures late, and the page stops for late pictures, as it should.
    """
    deadline = time.monotonic() + WAIT_S
    while not is_driving():
        assert time.monotonic() < deadline, f"the robot did not drive while {key} was held"
        await page.keyboard.up(key)
        await page.wait_for_selector(".age:not(.bad)")
        await page.keyboard.down(key)
        again = time.monotonic() + ANEW_S
        while not is_driving() and time.monotonic() < again:
            await asyncio.sleep(0.02)
