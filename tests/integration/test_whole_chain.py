"""Page → station → robot-server → emulated Mega, all real programs: the joystick turns the motor pins."""

import asyncio
import signal
import time
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.support.emulator import board
from tests.support.link import until
from tests.support.stopping.chain import Chain

pytestmark = [
    pytest.mark.skipif(board.missing_reason() is not None, reason=board.missing_reason() or ""),
    pytest.mark.slow,
]
WAIT_S = 90.0
# 250 ms at the station or robot-server, 300 ms in the firmware, the ramp; a busy PC delays all but the Mega's own part.
REST_US = 3_000_000


@pytest_asyncio.fixture
async def chain() -> AsyncIterator[Chain]:
    board.build()
    chain = Chain()
    try:
        await chain.start()
        yield chain
    finally:
        await chain.close()


async def rest(chain: Chain) -> None:
    """Wait until the motor pins are at rest; they may turn for so long of the Mega's own time."""
    since_us = await chain.mark()
    deadline = time.monotonic() + WAIT_S
    while chain.board.pins != (0, 0):
        assert time.monotonic() < deadline, "the motors keep running"
        await asyncio.sleep(0.01)
    ended_us = max(e.t_mega_us for e in chain.events() if e.text == "pins 0 0")
    assert ended_us - since_us < REST_US, f"the motors turned on for {(ended_us - since_us) / 1000:.0f} ms"


async def test_holding_the_joystick_turns_the_motor_pins_and_every_way_of_letting_go_stops_them(chain: Chain) -> None:
    assert chain.page is not None
    assert chain.board.pins == (0, 0)  # at start nothing moves before a fresh command

    await chain.moving()  # which waits for the pins
    await until(lambda: min(chain.board.pins) > 400)  # and they stay on, but where a busy machine is late once
    chain.page.holds = False
    await rest(chain)

    await chain.moving()
    chain.page.vanish()  # the tab is closed
    await rest(chain)
    await chain.open_page()

    await chain.moving()
    chain.signal(chain.robot, signal.SIGSTOP)  # only the firmware is left
    await rest(chain)
    chain.signal(chain.robot, signal.SIGCONT)

    await chain.moving()
    chain.signal(chain.robot, signal.SIGTERM)
    await rest(chain)
    assert chain.robot is not None and await asyncio.wait_for(chain.robot.wait(), WAIT_S) == 0
