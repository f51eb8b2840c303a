"""What every edit of places and rooms answers beside what it made: the version of the map that it led to."""

from __future__ import annotations

from typing import Any

from fastapi import Response

from station.library.place_changes import PlacesEdit

HEADER = "X-Change-Version"
VERSION: dict[int | str, dict[str, Any]] = {  # OpenAPI's entry
    200: {
        "headers": {
            HEADER: {
                "description": "`version` for POST /places/undo of just this change; absent: it was so already",
                "schema": {"type": "integer"},
            }
        }
    }
}


def tell_version(response: Response, edit: PlacesEdit) -> None:
    if edit.version is not None:
        response.headers[HEADER] = str(edit.version)
