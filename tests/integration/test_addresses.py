"""Host names that DNS cannot even hold are answered like every other wrong address."""

import asyncio

import pytest

from shared.errors import ConfigError
from shared.listening import bind
from station.robots.link import RobotLink
from tests.support.link import Notes, until

NO_NAMES = ["a..b", "x" * 64 + ".local"]


@pytest.mark.parametrize("host", NO_NAMES)
def test_a_program_that_cannot_listen_there_says_so(host: str) -> None:
    with pytest.raises(ConfigError, match=r"--host .* cannot be used"):
        bind(host, 0)


@pytest.mark.parametrize("host", NO_NAMES)
async def test_the_link_says_so_and_goes_on_trying(host: str) -> None:
    link = RobotLink(host, 7400, Notes())
    task = asyncio.create_task(link.run())
    try:
        await until(lambda: link.state.reason != "not connected yet" or task.done())
        assert not task.done() and "is no host name" in link.state.reason
    finally:
        task.cancel()
