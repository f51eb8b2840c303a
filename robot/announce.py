"""Makes the robot known in the local network, so that `station serve --robot auto` finds it without an address."""

from __future__ import annotations

import importlib.util
import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from shared.discovery import SERVICE_TYPE, ipv6_interfaces, own_addresses, service_label

if TYPE_CHECKING:
    from zeroconf import Zeroconf

logger = logging.getLogger(__name__)

LOOK_AGAIN_S = 5.0


class Announcement:
    """A DNS-SD entry that lives until `close` and follows the robot's address; failing is only logged.

    A thread of its own: registering takes seconds, and a robot that starts with its Pi has no address before the Wi-Fi.
    """

    def __init__(
        self, robot_id: str, port: int, addresses: Callable[[], list[str]], interfaces: Sequence[str] = ()
    ) -> None:
        """`addresses` is asked again and again; an empty list: none at present. `interfaces` empty: all."""
        self._robot_id = robot_id
        self._port = port
        self._addresses = addresses
        self._interfaces = list(interfaces)
        self._zeroconf: Zeroconf | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="announce", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take the entry back."""
        self._closed.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        if importlib.util.find_spec("zeroconf") is None:
            logger.info("zeroconf is not installed: stations need this robot's address")
            return
        announced: list[str] = []
        complaint = ""
        while not self._closed.is_set():
            addresses = self._addresses()
            if addresses != announced:
                try:
                    self._take_back()
                    announced = []
                    if addresses:
                        self._register(addresses)
                        announced = addresses
                except Exception as exc:  # its errors have no common base, and none may keep a robot from working
                    if repr(exc) != complaint:
                        logger.warning("this robot cannot be announced in the network (%r); trying on", exc)
                    complaint = repr(exc)
            self._closed.wait(LOOK_AGAIN_S)
        self._take_back()

    def _register(self, addresses: list[str]) -> None:
        from zeroconf import InterfaceChoice, ServiceInfo, Zeroconf

        label = service_label(self._robot_id)
        info = ServiceInfo(
            SERVICE_TYPE,
            f"{label}.{SERVICE_TYPE}",
            port=self._port,
            parsed_addresses=addresses,
            server=f"{label}.local.",
            properties={"robot_id": self._robot_id},
        )
        # Made anew each time: it knows only the interfaces that were up when it was made.
        is_ipv4 = any(ipaddress.ip_address(address).version == 4 for address in addresses)
        everywhere = InterfaceChoice.All if is_ipv4 else ipv6_interfaces()
        self._zeroconf = Zeroconf(interfaces=self._interfaces or everywhere)
        self._zeroconf.register_service(info, allow_name_change=True)
        logger.info("announced as %s at %s", info.name, ", ".join(addresses))

    def _take_back(self) -> None:
        ended, self._zeroconf = self._zeroconf, None
        if ended is not None:
            ended.close()


def may_be_announced(host: str) -> bool:
    """Whether others can ever reach a listener on `host`: not on loopback, nor do we ask what a name stands for."""
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def announced_addresses(host: str) -> list[str]:
    """Addresses under which others reach a listener on `host` now."""
    if not may_be_announced(host):
        return []
    listening = ipaddress.ip_address(host)
    if not listening.is_unspecified:
        return [host]
    found = _leading_out(socket.AF_INET, "192.0.2.1") or _own_addresses(4)
    if not found and listening.version == 6:
        found = _leading_out(socket.AF_INET6, "2001:db8::1") or _own_addresses(6)
    return found


def _leading_out(family: socket.AddressFamily, anywhere: str) -> list[str]:
    """The address of the interface that leads out. Connecting a datagram socket sends nothing."""
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((anywhere, 9))
            return [probe.getsockname()[0]]
    except OSError:
        return []


def _own_addresses(version: int) -> list[str]:
    """All but loopback: a network without a router leads nowhere."""
    return [str(ip) for ip, _ in own_addresses() if ip.version == version and not ip.is_loopback]
