"""The API: one FastAPI app over one station."""

from __future__ import annotations

from fastapi import APIRouter, Depends, FastAPI

from station.api import (
    access,
    calibration,
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
    rooms,
    slam,
)
from station.api.deps import admit_below, name_robot
from station.api.doorkeeper import Doorkeeper
from station.api.health import program_version
from station.api.limits import BodyLimit, SeatsByKind
from station.api.roles import ROLES, calls_of, check_roles
from station.api.schema.base import Problem
from station.app import Station

EACH_ROBOT = "/robots/{robot}"
OF_ROBOT = (robot, camera, calibration, places, slam, events, navigations)
SHARED = (robot, calibration, places, rooms, maps, replay, navigations, comparisons, health, access, page)
# Where each router is: what concerns one robot is there twice, with and without the robot's name.
ROUTERS: tuple[tuple[str, APIRouter], ...] = (
    *(("", part.of_robot) for part in OF_ROBOT),
    *(("", part.router) for part in SHARED),
    *((EACH_ROBOT, part.of_robot) for part in OF_ROBOT),
    *((prefix, part.itself) for part in (robot, access) for prefix in ("/robot", EACH_ROBOT)),
)
DESCRIPTION = """A robot's station: drive, record navigations, build maps of places, ask which place the robot is at.

Calls to a robot mean the first one; below `/robots/{robot}` the one of that name. Errors are problem documents
(RFC 9457). WebSockets: `/ws/drive`, `/ws/camera`, `/ws/events` (docs/api.md)."""


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
    app.state.seats = SeatsByKind()
    app.add_middleware(BodyLimit)
    app.add_middleware(Doorkeeper, station=station)
    problems.install(app)
    check_roles(all_calls(app))
    for prefix, router in ROUTERS:
        names_robot = prefix == EACH_ROBOT
        app.include_router(
            router,
            prefix=prefix,
            dependencies=[Depends(admit_below(prefix)), *([Depends(name_robot)] if names_robot else [])],
            responses=problems.responses(404) if names_robot else {},
        )
    _describe(app, asks_who=not station.access.door.is_open)
    return app


def all_calls(app: FastAPI | None = None) -> list[str]:
    """The names of all calls and sockets, with those that the app has by itself."""
    own = [call for route in app.routes for call in calls_of(route)] if app is not None else []
    return [*own, *(call for prefix, router in ROUTERS for route in router.routes for call in calls_of(route, prefix))]


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
