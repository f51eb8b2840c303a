"""Which pages may use this station. A browser would lend any page its way to the robot, and its cookie."""

from __future__ import annotations

import ipaddress
import socket
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection

from shared.bounded import shown
from shared.listening import is_loopback
from station.config import ApiConfig
from station.errors import NotAllowed

LOOPBACK = ("localhost", "127.0.0.1", "::1")
# What this machine is called in its own network. No site can be: its name would have a dot of another domain.
OWN_NAMES = {name for host in [socket.gethostname().lower()] if host for name in (host, f"{host}.local")}
EVERYWHERE = (str(ipaddress.IPv4Address(0)), str(ipaddress.IPv6Address(0)))
FOREIGN = ("cross-site", "same-site")  # the latter: another port, or another name below the same domain


def check_site(connection: HTTPConnection, api: ApiConfig, *, speaks_tls: bool) -> None:
    """Raises NotAllowed: another site's page asks.

    A page without a site (`Origin: null`: a sandboxed frame, a file) is one of them; so is a site whose name was
    pointed at this machine after the page was loaded (DNS rebinding): its name stands in `Host`, so the names of this
    station are a list. Pictures and scripts are asked for without `Origin`; browsers then say `Sec-Fetch-Site`.
    """
    headers = connection.headers
    host, *more = headers.getlist("host") or [""]
    if more:  # a proxy in front might have looked at the other one
        raise NotAllowed("a request names one Host, and this one names several")
    if not _is_ours(host, api):
        raise NotAllowed(
            f"this station does not go by the name {shown(host)}; put it into allowed_hosts under [api] if it shall"
        )
    origin = headers.get("origin")
    if origin is not None and not _is_our_page(origin, host, speaks_tls):
        raise NotAllowed(f"pages of {origin} may not use this station")
    if headers.get("sec-fetch-site") in FOREIGN and not _is_link(connection):
        raise NotAllowed("pages of other sites may not use this station")


def _is_link(connection: HTTPConnection) -> bool:
    """Whether a person followed a link, and will see the answer itself; no page gets it, nor the cookie."""
    headers = connection.headers
    opens = (headers.get("sec-fetch-mode"), headers.get("sec-fetch-dest")) == ("navigate", "document")
    return opens and connection.scope.get("method") == "GET"


def _is_our_page(origin: str, host: str, speaks_tls: bool) -> bool:
    """Anybody on the way can put words into a page of http://, so one is no page of a station that speaks https."""
    try:
        page = urlsplit(origin)
    except ValueError:
        return False
    return page.netloc == host and (not speaks_tls or page.scheme == "https")


def _is_ours(host: str, api: ApiConfig) -> bool:
    """Whether a Host header names this station: loopback, the address it listens on, or a name from the settings.

    Who listens on all addresses is reached by any of them. An address in numbers is no one else's to point at us.
    """
    try:
        name = (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return False
    if name in {*LOOPBACK, api.host.lower(), *(allowed.lower() for allowed in api.allowed_hosts)}:
        return True
    if name in OWN_NAMES and not is_loopback(api.host):
        return True
    return api.host in EVERYWHERE and _is_address(name)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
