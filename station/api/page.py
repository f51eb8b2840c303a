"""/, /docs and the page's files: everything from this machine, nothing from another host."""

from __future__ import annotations

import asyncio
import html
import shlex
import threading
from pathlib import Path

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, Response

from shared.advice import python
from station.errors import Unknown

DIST = Path(__file__).parents[1] / "web" / "dist"
ICON = Path(__file__).parents[1] / "web" / "public" / "favicon.svg"  # there also where the page was not built
# What the page may do: only this origin, no inline scripts; blob: are the pictures it decodes itself.
POLICY = (
    "default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; connect-src 'self' ws: wss:; "
    "object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = {"Content-Security-Policy": POLICY, "Referrer-Policy": "no-referrer"}
NOT_BUILT = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Sentinel</title>
<body style="font:16px/1.6 system-ui;max-width:42rem;margin:3rem auto;padding:0 1rem">
<h1>The page is not built yet</h1>
<p>The station runs, and its calls answer (<a href="/robot">/robot</a>, <a href="/openapi.json">/openapi.json</a>),
but the page's files were not made when it was installed, for example because the machine had no internet then.</p>
<p>Build them with <code>BUILD</code>, then reload.</p></body>
</html>""".replace("BUILD", html.escape(f"{python()} {shlex.quote(str(DIST.parent / 'build_hook.py'))}"))
DOCS = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Sentinel API</title>
<meta name="viewport" content="width=device-width,initial-scale=1"><link rel="icon" href="/favicon.svg">
<link rel="stylesheet" href="/docs/swagger-ui.css">
</head><body><div id="api"></div><script src="/docs/swagger-ui-bundle.js"></script>
<script src="/docs/start.js"></script>
</body></html>"""
START = "SwaggerUIBundle({url: '/openapi.json', dom_id: '#api', deepLinking: true, validatorUrl: null});\n"

_MAKING = threading.Lock()
router = APIRouter(include_in_schema=False)


@router.get("/")
async def page() -> Response:
    index = DIST / "index.html"
    if not index.is_file():
        return HTMLResponse(NOT_BUILT, headers=HEADERS)
    return FileResponse(index, headers=HEADERS | {"Cache-Control": "no-cache"})


@router.get("/assets/{name}")
async def asset(name: str) -> Response:
    return _file(DIST / "assets" / Path(name).name, "public, max-age=31536000, immutable")


@router.get("/favicon.svg")
@router.get("/favicon.ico")
async def favicon() -> Response:
    """Browsers ask for the latter beside whatever names no icon, such as an answer of the API."""
    return _file(ICON, "public, max-age=86400")


@router.get("/docs")
async def docs(request: Request) -> Response:
    if not (DIST / "docs" / "swagger-ui-bundle.js").is_file():
        return HTMLResponse(_plain_docs(request.app), headers=HEADERS)
    return HTMLResponse(DOCS, headers=HEADERS)


@router.get("/openapi.json")
async def openapi(request: Request) -> Response:
    return Response(await asyncio.to_thread(_document, request.app), media_type="application/json")


def _document(app: FastAPI) -> bytes:
    """Made once, beside the event loop: at the first time that takes a second, and 20 ms to encode it again."""
    with _MAKING:
        if not hasattr(app.state, "document"):
            app.state.document = bytes(JSONResponse(app.openapi()).body)
        document: bytes = app.state.document
    return document


@router.get("/docs/start.js")
async def docs_start() -> Response:
    return Response(START, media_type="text/javascript", headers=HEADERS)


@router.get("/docs/{name}")
async def docs_asset(name: str) -> Response:
    return _file(DIST / "docs" / Path(name).name, "public, max-age=86400")


def _file(path: Path, cache: str) -> Response:
    if not path.is_file():
        raise Unknown(f"there is no file {path.name}")
    return FileResponse(path, headers=HEADERS | {"Cache-Control": cache})


def _plain_docs(app: FastAPI) -> str:
    """The list of calls, where Swagger's files were not installed."""
    rows = [
        f"<tr><td><code>{method.upper()} {path}</code></td><td>{call.get('summary', '')}</td></tr>"
        for path, calls in app.openapi()["paths"].items()
        for method, call in calls.items()
    ]
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Sentinel API</title>'
        '<body style="font:15px/1.6 system-ui;margin:2rem"><h1>Sentinel API</h1>'
        f'<p>Complete: <a href="/openapi.json">openapi.json</a></p><table>{"".join(rows)}</table></body></html>'
    )
