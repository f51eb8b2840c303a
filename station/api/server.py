"""The API: one FastAPI app over one station."""

from __future__ import annotations

from fastapi import Depends, FastAPI

from station.api import (
    camera,
    comparisons,
    events,
    health,
    maps,
    navigations,
    page,
    places,
    problems,
    replay,
    robot,
    slam,
)
from station.api.deps import admit
from station.api.health import program_version
from station.api.limits import BodyLimit, Seats
from station.api.models import Problem
from station.app import Station

DESCRIPTION = """A robot's station: drive, record navigations, build maps of places, ask which place the robot is at.

Errors are problem documents (RFC 9457). WebSockets: `/ws/drive`, `/ws/camera`, `/ws/events` (docs/api.md)."""


def make_api(station: Station) -> FastAPI:
    """The app; the station itself must run beside it."""
    app = FastAPI(
        title="Sentinel station",
        version=program_version(),
        description=DESCRIPTION,
        docs_url=None,  # our own page: Swagger's files come from this machine
        redoc_url=None,
        responses=problems.responses(400, 403, 422),
    )
    app.state.station = station
    app.state.seats = Seats()
    app.add_middleware(BodyLimit)
    problems.install(app)
    for part in (robot, camera, places, maps, replay, navigations, comparisons, slam, events, health):
        app.include_router(part.router, dependencies=[Depends(admit)])
    app.include_router(page.router)
    _describe_problems(app)
    return app


def _describe_problems(app: FastAPI) -> None:
    """Put the problem document into the OpenAPI components, where the calls refer to it."""
    original = app.openapi

    def openapi() -> dict[str, object]:
        document = original()
        schemas = document.setdefault("components", {}).setdefault("schemas", {})
        schemas.setdefault("Problem", Problem.model_json_schema())
        return document

    app.openapi = openapi  # type: ignore[method-assign]
