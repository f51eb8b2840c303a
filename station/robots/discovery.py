"""Finds robots that make themselves known in the local network."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

from zeroconf import InterfaceChoice, ServiceBrowser, ServiceListener, Zeroconf

from shared.discovery import SERVICE_TYPE

LOOKUP_MS = 2000


def find_robot(seconds: float, interfaces: Sequence[str] = ()) -> tuple[str, int] | None:
    """Address of the first robot found within some seconds; None when there is none. Blocks.

    Args:
        seconds: how long to look.
        interfaces: addresses of the network interfaces to look on; none means all.
    """
    try:
        network = Zeroconf(interfaces=list(interfaces) or InterfaceChoice.All)
    except OSError:
        return None  # no network at all
    try:
        names = _Names()
        ServiceBrowser(network, SERVICE_TYPE, names)
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0 and names.found.wait(left):
            for name in names.take():
                info = network.get_service_info(SERVICE_TYPE, name, LOOKUP_MS)
                addresses = info.parsed_addresses() if info is not None else []
                if info is not None and info.port and addresses:
                    return addresses[0], info.port
        return None
    finally:
        network.close()


class _Names(ServiceListener):
    """Names of services as they turn up, filled by zeroconf's thread."""

    def __init__(self) -> None:
        self.found = threading.Event()
        self._names: list[str] = []

    def take(self) -> list[str]:
        self.found.clear()
        names, self._names = self._names, []
        return names

    def add_service(self, zc: Zeroconf, type_: str, name: str) -> None:  # noqa: ARG002
        self._names.append(name)
        self.found.set()

    def update_service(self, zc: Zeroconf, type_: str, name: str) -> None:
        self.add_service(zc, type_, name)

    def remove_service(self, zc: Zeroconf, type_: str, name: str) -> None: ...
