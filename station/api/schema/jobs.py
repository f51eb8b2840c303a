"""Work in the background."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from station.api.schema.base import Model


class JobModel(Model):
    """Work in the background."""

    id: str
    kind: str
    title: str
    state: Literal["running", "done", "failed", "cancelled"]
    progress: float = Field(description="0..1")
    message: str
    result: dict[str, str | int | float | None] | None
