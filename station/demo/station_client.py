"""The demo talks to the station like any other program: by its HTTP calls."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from typing import Any

from shared.errors import RobotSystemError

CALL_TIMEOUT_S = 30.0
DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # a proxy of the network knows no loopback


class StationClient:
    """Small client of the station's API; every answer is plain JSON."""

    def __init__(self, address: str) -> None:
        self.address = address

    def call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        """One call. Raises RobotSystemError with the problem document's words."""
        request = urllib.request.Request(  # noqa: S310 - the address is ours
            self.address + path,
            method=method,
            data=None if body is None else json.dumps(body).encode(),
            headers={"Content-Type": "application/json"},
        )
        try:
            with DIRECT.open(request, timeout=CALL_TIMEOUT_S) as answer:
                text = answer.read()
        except urllib.error.HTTPError as exc:
            raise RobotSystemError(f"{method} {path}: {exc.code} {_problem(exc.read())}") from exc
        except OSError as exc:
            raise RobotSystemError(f"{method} {path}: the station does not answer ({exc})") from exc
        return json.loads(text) if text else None

    def get(self, path: str) -> Any:
        return self.call("GET", path)

    def is_up(self) -> bool:
        """Whether the station serves."""
        try:
            self.get("/healthz")
        except RobotSystemError:
            return False
        return True


def _problem(text: bytes) -> str:
    try:
        document = json.loads(text)
        return str(document.get("detail") or document.get("title") or document)
    except (ValueError, AttributeError):
        return text.decode(errors="replace")[:200]
