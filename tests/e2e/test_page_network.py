"""The page behind a bad network: it comes back by itself."""

from __future__ import annotations

from urllib.parse import urlsplit

import pytest

from tests.e2e.conftest import LAPTOP, Room
from tests.support.fault_proxy import FaultProxy
from tests.support.link import until

pytestmark = [pytest.mark.browser, pytest.mark.asyncio(loop_scope="module")]

NEW_PICTURE = "seq => Number(document.querySelector('#video').dataset.seq) > seq"
SEQ = "Number(document.querySelector('#video').dataset.seq)"


async def test_a_page_whose_connections_are_dead_makes_new_ones(room: Room) -> None:
    """Neither browser nor station is told; a browser by itself would wait for minutes."""
    proxy = FaultProxy(urlsplit(room.desk.address).port or 0)
    await proxy.mend()
    context = await room.browser.new_context(**LAPTOP)
    try:
        page = await context.new_page()
        page.set_default_timeout(90_000)
        await page.goto(f"http://127.0.0.1:{proxy.port}")
        await page.wait_for_selector("#video[data-seq]")
        proxy.abandon()
        seq = await page.evaluate(SEQ)
        await page.wait_for_function(NEW_PICTURE, arg=seq + 2)
        await page.wait_for_selector("#link[data-state=good]")
        before = proxy.connections
        await proxy.cut()
        seq = await page.evaluate(SEQ)
        await proxy.mend()
        await page.wait_for_function(NEW_PICTURE, arg=seq + 2)
        await until(lambda: proxy.connections >= before + 3)  # events, video, driving
    finally:
        await context.close()
        await proxy.close()
