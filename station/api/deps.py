"""What every call needs: the station, who asks, and whether it may."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Annotated, cast

from fastapi import Depends, Header, Path
from starlette.requests import HTTPConnection

from shared.access import Role
from shared.text import printable
from station.access.visitors import Visitor
from station.api.doorkeeper import Found
from station.api.roles import ROLES
from station.app import Station
from station.errors import NotAllowed
from station.robots.driving import MAX_DRIVER_NAME
from station.robots.session import RobotSession

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
    """Whether the visitor's role, by `ROLES`, allows this call or socket. Every one goes through here.

    Before that, before anything of the body is read, `doorkeeper.py` has asked from which page and by whom.
    """
    needed = ROLES[call_of(connection, prefix)]
    if needed is None:
        return
    visitor = _visitor_of(connection)
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
    return _visitor_of(connection)


def _visitor_of(connection: HTTPConnection) -> Visitor:
    """Raises WrongToken, TooManyGuesses."""
    visitor: Found = connection.state.visitor
    if not isinstance(visitor, Visitor):
        raise visitor
    return visitor


def _station_of(connection: HTTPConnection) -> Station:
    return cast(Station, connection.app.state.station)


async def get_driver(
    connection: HTTPConnection,
    x_driver: Annotated[str | None, Header(description="your name as a driver; else your address")] = None,
) -> str:
    """The name a caller drives under; of who may not drive the token's name, which takes nobody's stop back."""
    visitor = _visitor_of(connection)
    if not visitor.role.includes(Role.DRIVE):
        return f"{visitor.name}, who watches"
    if x_driver:
        return driver_name(x_driver)
    return f"API client at {connection.client.host}" if connection.client else "API client"


def driver_name(given: str) -> str:
    """The name that somebody gives itself, as logs and other pages tell it.

    One that is too long stays so, and is refused where it drives; a stop counts whoever says it.
    """
    return printable(given[: MAX_DRIVER_NAME + 1])


VisitorDep = Annotated[Visitor, Depends(get_visitor)]
StationDep = Annotated[Station, Depends(get_station)]
RobotDep = Annotated[RobotSession, Depends(get_robot)]
DriverDep = Annotated[str, Depends(get_driver)]
