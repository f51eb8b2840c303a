"""What every call needs: the station, who asks, and whether it may."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Awaitable, Callable
from typing import Annotated, cast
from urllib.parse import urlsplit

from fastapi import Depends, Header, Path
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from shared.listening import is_loopback
from station.access.visitors import Visitor
from station.api.doorkeeper import Found
from station.api.roles import ROLES
from station.app import Station
from station.config import ApiConfig
from station.errors import NotAllowed
from station.robots.session import RobotSession

LOOPBACK = ("localhost", "127.0.0.1", "::1")
# What this machine is called in its own network. No site can be: its name would have a dot of another domain.
OWN_NAMES = {name for host in [socket.gethostname().lower()] if host for name in (host, f"{host}.local")}
EVERYWHERE = (str(ipaddress.IPv4Address(0)), str(ipaddress.IPv6Address(0)))


# Coroutines although they wait for nothing: FastAPI would call plain functions in a thread, for each request.


async def get_station(connection: HTTPConnection) -> Station:
    return _station_of(connection)


async def get_robot(connection: HTTPConnection) -> RobotSession:
    """The robot that the address names; the first one where it names none. Raises Unknown."""
    station = _station_of(connection)
    name: str | None = connection.path_params.get("robot")
    return station.first if name is None else station.robot(name)


async def name_robot(robot: Annotated[str, Path(description="its name in GET /robots")]) -> None:
    """Documents the parameter that `get_robot` reads."""


def admit_below(prefix: str) -> Callable[[HTTPConnection], Awaitable[None]]:
    """`admit`, for the calls of a router that stands below a prefix."""

    async def admit_there(connection: HTTPConnection) -> None:
        admit(connection, prefix)

    return admit_there


def admit(connection: HTTPConnection, prefix: str) -> None:
    """The one place that decides who may use the API: every call and socket goes through it, by its role in `ROLES`.

    Not pages of other sites: a browser would lend them its way to the robot, and its cookie. A page without a site
    (`Origin: null`: a sandboxed frame, a file) is one of them; so is a site whose name was pointed at this machine
    after the page was loaded (DNS rebinding): its name stands in `Host`, so the names of this station are a list.
    """
    host = connection.headers.get("host", "")
    if not _is_ours(host, _station_of(connection).config.api):
        raise HTTPException(
            403, f"this station does not go by the name {host!r}; put it into allowed_hosts under [api] if it shall"
        )
    origin = connection.headers.get("origin")
    if origin is not None and not _is_our_page(origin, host, _station_of(connection)):
        raise HTTPException(403, f"pages of {origin} may not use this station")
    call = call_of(connection, prefix)
    needed = ROLES[call]
    if needed is None:
        return
    visitor: Found = connection.state.visitor
    if not isinstance(visitor, Visitor):
        raise visitor
    if visitor.by == "cookie" and origin is None and not call.startswith("GET "):
        raise NotAllowed("a browser says which page asks (`Origin`); programs send `Authorization: Bearer` instead")
    if not visitor.role.includes(needed):
        raise NotAllowed(f"{visitor.name} may {visitor.role.value}, and this needs the role {needed.value}")


def call_of(connection: HTTPConnection, prefix: str) -> str:
    """The name of what is called, in `ROLES`."""
    path: str = connection.scope["route"].path
    if not path.startswith(prefix):  # newer FastAPI: routes do not know below which prefix they were included
        path = prefix + path
    return f"WS {path}" if connection.scope["type"] == "websocket" else f"{connection.scope['method']} {path}"


async def get_visitor(connection: HTTPConnection) -> Visitor:
    """Who asks, on a call that not everybody may."""
    visitor = connection.state.visitor
    if not isinstance(visitor, Visitor):
        raise visitor
    return visitor


def _station_of(connection: HTTPConnection) -> Station:
    return cast(Station, connection.app.state.station)


def _is_our_page(origin: str, host: str, station: Station) -> bool:
    """Anybody on the way can put words into a page of http://, so one is no page of a station that speaks https."""
    try:
        page = urlsplit(origin)
    except ValueError:
        return False
    return page.netloc == host and (station.access.identity is None or page.scheme == "https")


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


async def get_driver(
    connection: HTTPConnection,
    x_driver: Annotated[str | None, Header(description="your name as a driver; else your address")] = None,
) -> str:
    """The name a caller drives under."""
    if x_driver:
        return x_driver
    return f"API client at {connection.client.host}" if connection.client else "API client"


VisitorDep = Annotated[Visitor, Depends(get_visitor)]
StationDep = Annotated[Station, Depends(get_station)]
RobotDep = Annotated[RobotSession, Depends(get_robot)]
DriverDep = Annotated[str, Depends(get_driver)]
