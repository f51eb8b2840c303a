"""Takes the port a program serves on, before it touches anything else."""

from __future__ import annotations

import ipaddress
import socket

from shared.errors import ConfigError

# Connections that wait to be taken. Where there is no room for one more, its caller hears nothing and tries again after
# a second, STOP as well: as many as strangers open at once must fit. The kernel keeps some 300 bytes of each.
BACKLOG = 4096


def bind(host: str, port: int) -> socket.socket:
    """A listening, non-blocking socket; port 0 takes a free one.

    Raises:
        ConfigError: the address cannot be used, or another program has the port.
    """
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
    except (OSError, UnicodeError) as exc:  # UnicodeError: no name that DNS could hold, such as a..b
        raise ConfigError(f"--host {host} cannot be used ({exc}); give an address of this machine") from exc
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError as exc:
        listener.close()
        raise ConfigError(
            f"cannot listen on {show_address(host, port)} ({exc.strerror});"
            " stop the program that uses the port or choose another with --port"
        ) from exc
    listener.setblocking(False)
    return listener


def show_address(host: str, port: int) -> str:
    """HOST:PORT, and [HOST]:PORT of an IPv6 address: as addresses and `station.config.parse_address` are read."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_loopback(host: str) -> bool:
    """Whether only programs on this machine reach this address (or all addresses that this name has)."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        pass
    try:
        found = {str(address[0]) for *_, address in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)}
    except (OSError, UnicodeError):
        return False
    return bool(host) and bool(found) and all(ipaddress.ip_address(a.partition("%")[0]).is_loopback for a in found)
