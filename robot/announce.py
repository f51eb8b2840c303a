"""Makes the robot known in the local network, so that `station serve --robot auto` finds it without an address."""

from __future__ import annotations

import ipaddress
import logging
import socket
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING

from shared.discovery import SERVICE_TYPE

if TYPE_CHECKING:
    from zeroconf import Zeroconf

logger = logging.getLogger(__name__)


class Announcement:
    """A DNS-SD entry that lives until `close`. Registering takes seconds, hence a thread; failing is only logged."""

    def __init__(self, robot_id: str, port: int, addresses: Sequence[str], interfaces: Sequence[str] = ()) -> None:
        self._robot_id = robot_id
        self._port = port
        self._addresses = list(addresses)
        self._interfaces = list(interfaces)  # empty: all
        self._zeroconf: Zeroconf | None = None
        self._thread = threading.Thread(target=self._register, name="announce", daemon=True)
        self._thread.start()

    def _register(self) -> None:
        try:
            from zeroconf import InterfaceChoice, ServiceInfo, Zeroconf
        except ImportError:
            logger.info("zeroconf is not installed: stations need this robot's address")
            return
        label = self._robot_id.replace(".", "-")[:63] or "robot"
        info = ServiceInfo(
            SERVICE_TYPE,
            f"{label}.{SERVICE_TYPE}",
            port=self._port,
            parsed_addresses=self._addresses,
            server=f"{label}.local.",
            properties={"robot_id": self._robot_id},
        )
        try:
            self._zeroconf = Zeroconf(interfaces=self._interfaces or InterfaceChoice.All)
            self._zeroconf.register_service(info, allow_name_change=True)
            logger.info("announced as %s at %s", info.name, ", ".join(self._addresses))
        except Exception as exc:  # its errors have no common base, and none may keep a robot from working
            logger.warning("this robot cannot be announced in the network (%r); stations need its address", exc)

    def close(self) -> None:
        """Take the entry back."""
        self._thread.join(timeout=5.0)
        if self._zeroconf is not None:
            self._zeroconf.close()


def announced_addresses(host: str) -> list[str]:
    """Addresses under which others reach a listener on `host`; none for loopback."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return []
    if address.is_loopback:
        return []
    if not address.is_unspecified:
        return [host]
    # The address of the interface that leads out. Connecting a datagram socket sends nothing.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return []
        return [probe.getsockname()[0]]
