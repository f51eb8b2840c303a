"""The API: one FastAPI app over one station."""

from __future__ import annotations

from fastapi import Depends, FastAPI

from station.api import (
    access,
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
from station.api.doorkeeper import Doorkeeper
from station.api.health import program_version
from station.api.limits import BodyLimit, Seats
from station.api.models import Problem
from station.api.roles import ROLES, check_roles
from station.app import Station

PARTS = (robot, camera, places, maps, replay, navigations, comparisons, slam, events, health, access, page)
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
        openapi_url=None,  # a call of ours instead, which has a role
        responses=problems.responses(400, 401, 403, 422, 429),
    )
    app.state.station = station
    app.state.seats = Seats()
    app.add_middleware(BodyLimit)
    app.add_middleware(Doorkeeper, door=station.access.door)
    problems.install(app)
    check_roles([*app.routes, *(route for part in PARTS for route in part.router.routes)])
    for part in PARTS:
        app.include_router(part.router, dependencies=[Depends(admit)])
    _describe(app, asks_who=not station.access.door.is_open)
    return app


def _describe(app: FastAPI, asks_who: bool) -> None:
    """Put into OpenAPI what it cannot know: the problem document, how to show a token, which role a call needs."""
    original = app.openapi

    def openapi() -> dict[str, object]:
        document = original()
        schemas = document.setdefault("components", {}).setdefault("schemas", {})
        schemas.setdefault("Problem", Problem.model_json_schema())
        schemes = {"token": {"type": "http", "scheme": "bearer"}}
        document["components"].setdefault("securitySchemes", schemes)
        for path, calls in document["paths"].items():
            for method, call in calls.items():
                role = ROLES[f"{method.upper()} {path}"]
                call["security"] = [{"token": []}] if asks_who and role is not None else []
                call["x-role"] = None if role is None else role.value
        return document

    app.openapi = openapi  # type: ignore[method-assign]
