"""What breaks between the page and the Mega, and since when the robot must stop."""

from __future__ import annotations

import asyncio
import random
import signal
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

from tests.support.stopping.chain import Chain, Page


@dataclass(frozen=True)
class Instant:
    """The fault's moment by both clocks; each is taken before the fault acts, so no figure is flattered."""

    since_ns: int  # our monotonic clock
    mega_us: int
    moved: str = ""  # what moved that should not have, before the fault's moment


Inject = Callable[[Chain, random.Random], Awaitable[Instant]]


async def now(chain: Chain) -> Instant:
    mega_us = await chain.mark()
    return Instant(time.monotonic_ns(), mega_us)


async def page_closed(chain: Chain, _rng: random.Random) -> Instant:
    assert chain.page is not None
    instant = await now(chain)
    chain.page.vanish()
    return instant


async def page_frozen(chain: Chain, _rng: random.Random) -> Instant:
    assert chain.page is not None
    instant = await now(chain)
    chain.page.holds = False  # the connection stays, nothing comes
    return instant


async def network_cut(chain: Chain, rng: random.Random) -> Instant:
    """Behind the station or before it."""
    instant = await now(chain)
    rng.choice([chain.cable, chain.page_cable]).is_cut = True
    return instant


async def page_and_network_stall(chain: Chain, rng: random.Random) -> Instant:
    """The page says nothing any more, and within a moment one network or both stand still with what is under way."""
    assert chain.page is not None
    cables = rng.choice([[chain.cable], [chain.page_cable], [chain.cable, chain.page_cable]])
    page_first = rng.random() < 0.5
    instant = await now(chain)
    if page_first:
        chain.page.holds = False
        await asyncio.sleep(0.15 * rng.random())
    for cable in cables:
        cable.is_cut = True
    if not page_first:
        await asyncio.sleep(0.15 * rng.random())
        chain.page.holds = False
    return instant


async def page_dies_in_stall(chain: Chain, rng: random.Random) -> Instant:
    """A network stands still, the page talks on into it and then dies; what it had said flows when the stall ends."""
    assert chain.page is not None
    cables = rng.choice([[chain.cable], [chain.page_cable], [chain.cable, chain.page_cable]])
    instant = await now(chain)
    for cable in cables:
        cable.is_cut = True
    await asyncio.sleep(0.4 * rng.random())
    chain.page.vanish()
    return instant


def killing(who: str, number: int) -> Inject:
    async def inject(chain: Chain, _rng: random.Random) -> Instant:
        instant = await now(chain)
        chain.signal(getattr(chain, who), number)
        return instant

    return inject


async def loop_blocked(chain: Chain, rng: random.Random) -> Instant:
    instant = await now(chain)
    await chain.tell_robot(rng.choice(["busy", "asleep"]))
    blocked = await chain.logged("block")  # stamped by the loop itself, as its last deed
    return Instant(blocked.before_ns, instant.mega_us)


async def serial_unplugged(chain: Chain, _rng: random.Random) -> Instant:
    instant = await now(chain)
    chain.board.command("serial 0")
    return instant


async def interpreter_held(chain: Chain, _rng: random.Random) -> Instant:
    """The camera's library hangs and lets no other Python run: what robot-server has left is the firmware."""
    instant = await now(chain)
    await chain.tell_robot("hold")
    return Instant((await chain.logged("block")).before_ns, instant.mega_us)


async def clock_jumped(chain: Chain, rng: random.Random) -> Instant:
    """The wall clock of robot, station or both, forwards or backwards, by a day or by less than a command lives."""
    for name in rng.choice([["robot"], ["station"], ["robot", "station"]]):
        chain.clocks[name].jump(rng.choice([-1.0, 1.0]) * rng.choice([86_400.0, 3.0, 0.2]))
    await chain.tell_robot("wall")
    entry = await chain.logged("wall:")
    told_s = (int(entry.what.removeprefix("wall:")) - time.time_ns()) * 1e-9
    if abs(told_s - chain.clocks["robot"].shift_s) > 0.1 + chain.age_s(entry):
        raise RuntimeError(f"robot-server's wall clock is off by {told_s:.2f} s, not {chain.clocks['robot'].shift_s}")
    await asyncio.sleep(0.1 * rng.random())
    return await page_frozen(chain, rng)


def then_silent(line: str) -> Inject:
    """A fault that need not stop a driven robot; it must not keep it from stopping once the driver is silent."""

    async def inject(chain: Chain, rng: random.Random) -> Instant:
        await chain.tell_robot(line)
        await asyncio.sleep(0.1 + 0.1 * rng.random())
        return await page_frozen(chain, rng)

    return inject


async def two_drivers(chain: Chain, rng: random.Random) -> Instant:
    other = Page(chain.address, "other", -0.3)
    await other.open()
    other.holds = True
    await asyncio.sleep(0.15 + 0.1 * rng.random())
    moved = any(event.text.startswith("pins -") for event in chain.events())
    await other.close()
    instant = await page_frozen(chain, rng)
    return replace(instant, moved="by the second driver") if moved else instant


@dataclass(frozen=True)
class Fault:
    """One row of the table."""

    name: str
    count: int
    inject: Inject
    is_above_server: bool = True  # robot-server itself and its line are whole: it must stop, and says when it did
    lasts: bool = False  # until it is mended; then its end is watched as well


FAULTS = [
    Fault("page closed", 60, page_closed),
    Fault("page frozen", 60, page_frozen),
    Fault("network cut (half-open)", 45, network_cut, lasts=True),
    Fault("page and network stall together", 45, page_and_network_stall, lasts=True),
    Fault("page dies during a stall", 45, page_dies_in_stall, lasts=True),
    Fault("station SIGKILL", 10, killing("station", signal.SIGKILL), lasts=True),
    Fault("station SIGSTOP", 50, killing("station", signal.SIGSTOP), lasts=True),
    Fault("robot-server's loop blocked", 45, loop_blocked, lasts=True),
    Fault("robot-server SIGSTOP", 60, killing("robot", signal.SIGSTOP), is_above_server=False, lasts=True),
    Fault("robot-server SIGKILL", 30, killing("robot", signal.SIGKILL), is_above_server=False, lasts=True),
    Fault("serial unplugged", 45, serial_unplugged, is_above_server=False, lasts=True),
    Fault("camera hung, driver silent", 45, then_silent("camera hang")),
    Fault("camera hung, holds the interpreter", 45, interpreter_held, is_above_server=False, lasts=True),
    Fault("flood of frames, driver silent", 45, then_silent("camera flood")),
    Fault("two drivers, both silent", 45, two_drivers),
    Fault("wall clock jumped, driver silent", 45, clock_jumped),
]
