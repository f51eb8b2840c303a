"""Every error of the API as a problem document (RFC 9457)."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from typing import Any, get_args

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from shared.bounded import shortened, shown
from shared.errors import ConfigError, DataError, LocalProtocolError, RobotSystemError
from station import errors
from station.api.schema.base import Problem

logger = logging.getLogger(__name__)
MEDIA_TYPE = "application/problem+json"

# What was raised -> slug, title, status; the first that fits.
KINDS: tuple[tuple[type[RobotSystemError], str, str, int], ...] = (
    (errors.WrongToken, "unauthorized", "Who are you", 401),
    (errors.NotAllowed, "not-allowed", "Not allowed", 403),
    (errors.TooManyGuesses, "too-many-guesses", "Too many wrong tokens", 429),
    (errors.Unknown, "not-found", "Not found", 404),
    (errors.NotDriver, "not-driver", "Another one drives", 409),
    (errors.NotCapable, "not-capable", "This robot cannot do that", 409),
    (errors.Conflict, "conflict", "Not now", 409),
    (errors.NoRobot, "no-robot", "No robot is connected", 503),
    (errors.Busy, "busy", "Too many already", 503),
    (errors.OutOfRange, "out-of-range", "A value is out of range", 422),
    (LocalProtocolError, "out-of-range", "A value is out of range", 422),
    (DataError, "data", "The data do not allow it", 409),
    (ConfigError, "configuration", "The configuration does not allow it", 409),
    (RobotSystemError, "failed", "It did not work", 500),
)
MAX_MISTAKES = 20  # of one request that are said; a body has room for 5000
STATUS_TITLES = {
    400: "Bad request",
    403: "Not allowed",
    404: "Not found",
    405: "Method not allowed",
    408: "Too slow",
    413: "Too large",
    422: "The request is not valid",
}


def kind_of(error: RobotSystemError) -> tuple[str, str, int]:
    """Slug, title, status of an error of ours."""
    return next((slug, title, status) for kind, slug, title, status in KINDS if isinstance(error, kind))


def responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI entries of the problems a call may answer with."""
    titles = {
        400: "no text in UTF-8",
        401: "no token, or one that is not valid",
        403: "a foreign page, or the token's role may not",
        429: "too many wrong tokens",
        404: "not found",
        409: "not now",
        422: "not valid",
        503: "no robot is connected",
    }
    schema = {"schema": {"$ref": "#/components/schemas/Problem"}}
    return {status: {"description": titles[status], "content": {MEDIA_TYPE: schema}} for status in statuses}


def problem(request: HTTPConnection, status: int, slug: str, title: str, detail: str, **more: Any) -> JSONResponse:
    """One problem document."""
    document = Problem(
        type=f"/problems/{slug}", title=title, status=status, detail=detail, instance=request.url.path
    ).model_dump()
    return JSONResponse(document | more, status_code=status, media_type=MEDIA_TYPE)


def answer_to(request: HTTPConnection, exc: RobotSystemError) -> JSONResponse:
    """The problem document of an error of ours."""
    slug, title, status = kind_of(exc)
    if status >= 500 and slug == "failed":
        logger.error("%s %s: %s", request.scope.get("method", "WS"), request.url.path, exc)
    answer = problem(request, status, slug, title, str(exc))
    if isinstance(exc, errors.WrongToken):
        answer.headers["WWW-Authenticate"] = "Bearer"
    if isinstance(exc, errors.TooManyGuesses):
        answer.headers["Retry-After"] = str(math.ceil(exc.wait_s))
    return answer


def _what_is_wrong(request: Request, error: Mapping[str, Any]) -> str:
    """One mistake of a request, in words that name the remedy."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip()
    match error["type"]:
        case "json_invalid":
            return f"the body is no JSON ({error['ctx']['error']} at character {error['loc'][-1]})"
        case "model_attributes_type" | "dict_type" if error["loc"] == ("body",) and not _is_json(kind):
            said = f"says {shown(kind)}" if kind else "does not say what it is"
            return f"the body {said}; send JSON with the header Content-Type: application/json"
        case "model_attributes_type" | "dict_type" if error["loc"] == ("body",):
            return 'the body must be a JSON object, such as {"name": "value"}'
        case "extra_forbidden":
            known = _known_fields(request)
            return "there is no such field" + (f"; known are {', '.join(known)}" if known else "; /docs lists them")
        case "missing" if error["loc"] == ("body",):
            return "a JSON body is needed; /docs has an example"
        case "value_error":
            return str(error["ctx"]["error"])
    return str(error["msg"])


def _unreadable_body(request: Request, why: BaseException) -> JSONResponse:
    """Of one that is text and yet no JSON that anybody reads: 422, as of one whose brackets do not match."""
    if isinstance(why, UnicodeDecodeError):
        return problem(request, 400, "bad-request", STATUS_TITLES[400], "the body is no text in UTF-8; send JSON in it")
    what = "it nests too deep" if isinstance(why, RecursionError) else "a number in it has too many digits"
    errors = [{"where": "body", "what": f"the body is no JSON that is read ({what})"}]
    return problem(request, 422, "invalid", STATUS_TITLES[422], errors[0]["what"], errors=errors)


def _where(error: Mapping[str, Any]) -> str:
    """Which field it is; a body may name a field by a million letters."""
    return ".".join(shortened(str(part)) for part in error["loc"])


def _is_json(content_type: str) -> bool:
    return content_type == "application/json" or content_type.endswith("+json")


def _known_fields(request: Request) -> list[str]:
    """Of the body that the called route takes."""
    body = getattr(request.scope.get("route"), "body_field", None)
    whole = None if body is None else body.field_info.annotation
    for kind in (whole, *get_args(whole)):  # "X | None" where a body may be left out
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return list(kind.model_fields)
    return []


def install(app: FastAPI) -> None:
    """Give the app its error handlers."""

    @app.exception_handler(RobotSystemError)
    async def ours(request: Request, exc: RobotSystemError) -> JSONResponse:
        return answer_to(request, exc)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, exc: RequestValidationError) -> JSONResponse:
        errors = [
            {"where": _where(error), "what": _what_is_wrong(request, error)} for error in exc.errors()[:MAX_MISTAKES]
        ]
        detail = "; ".join(f"{e['where'].removeprefix('body.')}: {e['what']}" for e in errors[:5])
        return problem(request, 422, "invalid", "The request is not valid", detail, errors=errors)

    @app.exception_handler(HTTPException)
    async def http(request: Request, exc: HTTPException) -> JSONResponse:
        # FastAPI, of any body that json.loads cannot read
        if exc.status_code == 400 and isinstance(exc.__cause__, ValueError | RecursionError):
            return _unreadable_body(request, exc.__cause__)
        title = STATUS_TITLES.get(exc.status_code, "The request failed")
        detail = str(exc.detail)
        if exc.status_code == 404 and detail == "Not Found":
            detail = f"there is nothing at {shortened(request.url.path)}; /docs lists all calls"
        if exc.status_code == 405:
            allowed = Headers(exc.headers or {}).get("allow", "")
            what = f"{shortened(request.method)} is not possible at {shortened(request.url.path)}"
            detail = what + (f"; use {allowed}" if allowed else "")
        answer = problem(request, exc.status_code, title.lower().replace(" ", "-"), title, detail)
        for name, value in (exc.headers or {}).items():
            answer.headers[name] = value
        return answer

    @app.exception_handler(Exception)
    async def bug(request: Request, exc: Exception) -> JSONResponse:
        logger.exception("%s %s", request.method, request.url.path, exc_info=exc)
        return problem(request, 500, "bug", "An error of the station", "the station's log has the details")
