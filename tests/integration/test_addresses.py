"""Host names that DNS cannot even hold are answered like every other wrong address."""

import asyncio
import re

import pytest

from robot.access import pairing_sentence
from shared.errors import ConfigError
from shared.listening import bind, show_address
from station.commands.doctor import free_port
from station.config import RobotConfig, StationConfig, parse_address
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


def test_addresses_of_ipv6_have_brackets_wherever_a_sentence_has_them() -> None:
    with bind("::1", 0) as listener:
        port = listener.getsockname()[1]
        address = show_address("::1", port)
        assert address == f"[::1]:{port}"
        with pytest.raises(ConfigError, match=re.escape(f"cannot listen on {address} ")):
            bind("::1", port)
    assert f"{address} is free" in str(free_port("::1", port))
    pairing = pairing_sentence("123456", "::1", port)
    assert parse_address(pairing.partition("station pair ")[2].split()[0], "ROBOT") == ("::1", port)
    with pytest.raises(ConfigError, match=re.escape(f"{address} is given twice")):
        StationConfig(robots=(RobotConfig("::1", port), RobotConfig("::1", port)))
