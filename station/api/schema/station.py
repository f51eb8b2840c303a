"""The station itself: health, log, who is logged in."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from station.api.schema.base import Model


class LogModel(Model):
    """Something a person may want to know."""

    number: int
    unix_s: float
    level: Literal["info", "warning", "error"]
    topic: str
    text: str


class HealthModel(Model):
    status: Literal["ok"]
    version: str
    uptime_s: float
    robot_connected: bool
    localisation: str = Field(description="in words")


class SessionModel(Model):
    """Who asks."""

    controlled: bool = Field(description="false: everybody who reaches this station is admin")
    name: str
    role: Literal["watch", "drive", "admin"]
