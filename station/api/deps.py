"""What every call needs: the station, who asks, and whether it may."""

from __future__ import annotations

from typing import Annotated, cast
from urllib.parse import urlsplit

from fastapi import Depends, Header
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from station.app import Station


def get_station(connection: HTTPConnection) -> Station:
    return cast(Station, connection.app.state.station)


def admit(connection: HTTPConnection) -> None:
    """The one place that decides who may use the API; tokens belong here.

    Now: everybody who reaches the port, which listens on loopback unless --host says otherwise. But not pages of other
    sites: a browser on this machine would lend them its way to the robot.
    """
    origin = connection.headers.get("origin")
    if origin and origin != "null" and urlsplit(origin).netloc != connection.headers.get("host"):
        raise HTTPException(403, f"pages of {origin} may not use this station")


def get_driver(
    connection: HTTPConnection,
    x_driver: Annotated[str | None, Header(description="your name as a driver; else your address")] = None,
) -> str:
    """The name a caller drives under."""
    if x_driver:
        return x_driver
    return f"API client at {connection.client.host}" if connection.client else "API client"


StationDep = Annotated[Station, Depends(get_station)]
DriverDep = Annotated[str, Depends(get_driver)]
