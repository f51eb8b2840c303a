"""Finds robots that make themselves known in the local network. Anybody there may say anything: nothing is believed."""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import Collection, Sequence

from zeroconf import BadTypeInNameException, Error, InterfaceChoice, ServiceStateChange, Zeroconf
from zeroconf.asyncio import AsyncServiceBrowser, AsyncServiceInfo, AsyncZeroconf

from shared.discovery import SERVICE_TYPE, ipv6_interfaces, own_addresses, service_label
from station.robots.search import FoundRobot

SETTLE_S = 0.5  # all answer a question within a tenth of a second, or a second if somebody else has just asked it
LOOKUP_MS = 1000
MAX_SERVICES = 32  # looked up at once; of more by chance, so that nobody can fill the list for long
MAX_ADDRESSES = 4  # of one service
MAX_LABEL_BYTES, TYPE_PTR, CLASS_IN = 63, 12, 1  # RFC 1035


def find_robots(
    seconds: float, preferred: Collection[str] = (), interfaces: Sequence[str] = ()
) -> tuple[FoundRobot, ...]:
    """All that make themselves known, each address of each. Blocks.

    Args:
        seconds: how long to look; less once a preferred one (of none: anybody) has answered and nobody else does.
        preferred: ids of robots that are looked up before others.
        interfaces: addresses of the network interfaces to look on; none means all.
    """
    try:
        return asyncio.run(_find(seconds, preferred, interfaces))
    except OSError:
        return ()  # no network at all


async def _find(seconds: float, preferred: Collection[str], interfaces: Sequence[str]) -> tuple[FoundRobot, ...]:
    network = _open(interfaces)
    try:
        labels = tuple(map(service_label, preferred))
        services = chosen(await _listen(network.zeroconf, seconds, labels), labels)
        await asyncio.gather(*(_look_up(service, network.zeroconf) for service in services))
        return tuple(found for service in services for found in _robots(service))
    finally:
        await network.async_close()


async def _look_up(service: AsyncServiceInfo, network: Zeroconf) -> None:
    """What it says of itself may be nothing that can be asked for: then it has no address."""
    with contextlib.suppress(Error):
        await service.async_request(network, LOOKUP_MS)


def _open(interfaces: Sequence[str]) -> AsyncZeroconf:
    """Raises OSError: there is no network."""
    if not interfaces and (by_ipv6 := ipv6_interfaces()):
        with contextlib.suppress(OSError, RuntimeError):  # a system may have one of the two only
            return AsyncZeroconf(interfaces=[*(str(ip) for ip, _ in own_addresses() if ip.version == 4), *by_ipv6])
    if not interfaces and not own_addresses():  # zeroconf would leave a socket open
        raise OSError("this machine has no address")
    return AsyncZeroconf(interfaces=list(interfaces) or InterfaceChoice.All)


async def _listen(network: Zeroconf, seconds: float, labels: tuple[str, ...]) -> list[str]:
    """Names of services that turn up; those that begin with one of `labels` are waited for."""
    names: dict[str, None] = {}
    fresh = asyncio.Event()

    def on_change(zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange) -> None:  # noqa: ARG001
        if not _can_be_asked_for(name):
            # Each question says what is known already, and with this among it zeroconf could ask nothing any more.
            known = zeroconf.cache.get_all_by_details(SERVICE_TYPE, TYPE_PTR, CLASS_IN)
            zeroconf.cache.async_remove_records([one for one in known if getattr(one, "alias", None) == name])
        elif state_change is not ServiceStateChange.Removed:
            names[name] = None
            fresh.set()

    browser = AsyncServiceBrowser(network, SERVICE_TYPE, handlers=[on_change])
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await fresh.wait()
            while True:
                fresh.clear()
                is_enough = not labels or any(name.startswith(labels) for name in names)
                await asyncio.wait_for(fresh.wait(), SETTLE_S if is_enough else seconds)
    await browser.async_cancel()
    return list(names)


def _can_be_asked_for(name: str) -> bool:
    """A label that was no text became longer when it was read as one."""
    return all(len(label.encode()) <= MAX_LABEL_BYTES for label in name.split("."))


def chosen(names: list[str], labels: tuple[str, ...]) -> list[AsyncServiceInfo]:
    """The services that are looked up, the likeliest first."""
    own = {f"{label}.{SERVICE_TYPE}" for label in labels}
    random.shuffle(names)
    names.sort(key=lambda name: (name not in own, not name.startswith(labels)))  # a longer name may be anybody's
    services = []
    for name in names[:MAX_SERVICES]:
        with contextlib.suppress(BadTypeInNameException):  # anybody may announce any name
            services.append(AsyncServiceInfo(SERVICE_TYPE, name))
    return services


def _robots(service: AsyncServiceInfo) -> list[FoundRobot]:
    robot_id = (service.properties.get(b"robot_id") or b"").decode(errors="replace")
    addresses = service.parsed_scoped_addresses()[:MAX_ADDRESSES] if service.port else []
    return [FoundRobot(robot_id, address, service.port or 0) for address in addresses]
