"""/login, /session, /access/tokens, /robot/pair: who may."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Response
from pydantic import Field
from starlette.requests import Request

from shared.access import Role
from shared.bounded import shown
from shared.errors import ConfigError
from shared.pairing import parse_code
from station.access.pairing import PairingFailed, confirm, pair
from station.access.visitors import MAX_TOKEN_DAYS, SESSION_S, Visitor
from station.api.deps import RobotDep, StationDep, VisitorDep
from station.api.doorkeeper import COOKIE, address_of
from station.api.problems import responses
from station.api.schema.base import Model, Question
from station.api.schema.station import SessionModel
from station.config import parse_address
from station.errors import Conflict, OutOfRange, Unknown

router = APIRouter(tags=["access"])
itself = APIRouter(tags=["access"])  # below /robot
STATION_NAME = 64


class LoginOrder(Question):
    token: str = Field(max_length=256, description="a token, or the code of a login link")


class TokenOrder(Question):
    name: str = Field(min_length=1, max_length=64)
    role: Annotated[Role, Field(strict=False)]  # a word in JSON
    days: float | None = Field(
        default=None, gt=0, le=MAX_TOKEN_DAYS, description="it ends by itself; null: it does not"
    )


class TokenModel(Model):
    id: str
    name: str
    role: Role
    created_s: float
    last_used_s: float | None
    expires_s: float | None
    revoked_s: float | None


class NewTokenModel(Model):
    name: str
    role: Role
    token: str = Field(description="shown only now")


class PairOrder(Question):
    code: Annotated[str, Field(max_length=32, description="as the robot shows it")]
    robot: str | None = Field(default=None, max_length=300, description="HOST:PORT; null: as in the settings")


class PairedModel(Model):
    robot: str
    host: str
    port: int
    fingerprint: str = Field(description="SHA-256 of the robot's certificate, hex")


@router.post("/login", summary="A token for a cookie", responses=responses(409))
async def login(order: LoginOrder, request: Request, response: Response, station: StationDep) -> SessionModel:
    """For browsers; programs send their token with each call (`Authorization: Bearer`)."""
    door = station.access.door
    if door.is_open:
        raise Conflict("this station has no access control; there is nothing to log in to")
    visitor, session = await asyncio.to_thread(door.login, order.token, address_of(request))
    response.set_cookie(
        COOKIE, session, max_age=int(SESSION_S), path="/", secure=True, httponly=True, samesite="strict"
    )
    return _session(visitor, controlled=True)


@router.post("/logout", summary="Forget this browser", status_code=204)
async def logout(visitor: VisitorDep, station: StationDep) -> Response:
    if visitor.by == "cookie":
        await asyncio.to_thread(station.access.door.book.revoke, visitor.token_id, station.access.door.now_s())
    answer = Response(status_code=204)
    answer.delete_cookie(COOKIE, path="/", secure=True, httponly=True, samesite="strict")
    return answer


@router.get("/session", summary="Who am I, and what may I do")
async def session(visitor: VisitorDep, station: StationDep) -> SessionModel:
    return _session(visitor, controlled=not station.access.door.is_open)


@router.get("/access/tokens", summary="Who may, and who no longer may", responses=responses(409))
async def tokens(station: StationDep) -> list[TokenModel]:
    station.access.door.book.refresh()
    return [TokenModel.of(record) for record in station.access.door.book.tokens()]


@router.post("/access/tokens", summary="A token for somebody", status_code=201, responses=responses(409))
async def add(order: TokenOrder, station: StationDep) -> NewTokenModel:
    """It is shown in this answer and never again."""
    door = station.access.door
    lifetime_s = None if order.days is None else order.days * 86_400
    try:
        token = await asyncio.to_thread(door.book.add, order.name, order.role, door.now_s(), lifetime_s)
    except ConfigError as exc:
        raise Conflict(str(exc)) from exc
    return NewTokenModel(name=order.name, role=order.role, token=token.text)


@router.delete("/access/tokens/{token_id}", summary="Revoke a token", status_code=204, responses=responses(404, 409))
async def revoke(token_id: str, station: StationDep) -> None:
    """What it has open is closed at once."""
    door = station.access.door
    if not await asyncio.to_thread(door.book.revoke, token_id, door.now_s()):
        raise Unknown(f"there is no token {shown(token_id)} that may; GET /access/tokens lists them")
    door.look()


@itself.post("/pair", summary="Pair with a robot", responses=responses(409))
async def pair_robot(order: PairOrder, station: StationDep, which: RobotDep) -> PairedModel:
    """The code that `robot-server pair` shows becomes this station's token there; the link uses it at once."""
    config = station.config
    try:
        code = parse_code(order.code)
        host, port = parse_address(order.robot, "robot") if order.robot else (which.config.host, which.config.port)
    except ConfigError as exc:
        raise OutOfRange(str(exc)) from exc
    await asyncio.to_thread(station.access.robots.check_writable)
    try:
        paired = await pair(host, port, code, config.name)
    except PairingFailed as exc:
        raise Conflict(str(exc)) from exc
    await asyncio.to_thread(station.access.robots.store, paired)
    which.events.notify("link", f"paired with {paired.name}")
    if unconfirmed := await confirm(paired):
        which.events.notify("link", unconfirmed, "warning")
    return PairedModel(robot=paired.name, host=host, port=port, fingerprint=paired.fingerprint)


def _session(visitor: Visitor, controlled: bool) -> SessionModel:
    return SessionModel(controlled=controlled, name=visitor.name, role=visitor.role.value)
