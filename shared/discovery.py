"""How robots are found: their usual port, and the name under which they make themselves known (DNS-SD over mDNS)."""

from __future__ import annotations

import ipaddress

SERVICE_TYPE = "_sentinel._tcp.local."
DEFAULT_PORT = 7400


def service_label(robot_id: str) -> str:
    """How a robot is called in DNS-SD; a number follows where another one has the name."""
    return robot_id.replace(".", "-")[:63] or "robot"


def own_addresses() -> list[tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int]]:
    """Addresses of this machine, each with the number of its interface; empty where zeroconf is not installed."""
    try:
        from ifaddr import get_adapters  # it comes with zeroconf
    except ImportError:
        return []
    return [
        (ipaddress.ip_address(ip.ip if isinstance(ip.ip, str) else ip.ip[0]), adapter.index or 0)
        for adapter in get_adapters()
        for ip in adapter.ips
    ]


def ipv6_interfaces() -> list[int]:
    """Where mDNS is spoken by IPv6: not on loopback, which takes no multicast."""
    return sorted({index for ip, index in own_addresses() if ip.version == 6 and not ip.is_loopback})
