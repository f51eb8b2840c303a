"""The robots of this station, a line each."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from station.api.schema.base import Model
from station.api.schema.places import (
    PlaceName,
    current_place,
)
from station.api.schema.robot import RobotModel, robot_model
from station.robots.session import RobotSession


class RobotEntry(Model):
    """One of the station's robots, and where it is."""

    name: str = Field(description="in this station", examples=["robot-1"])
    path: str = Field(description="put before a call to ask for this robot", examples=["/robots/robot-1"])
    navigation: str | None = Field(description="id of the one that is being recorded")
    state: Literal["known", "unknown", "lost"]
    place: PlaceName | None
    robot: RobotModel


def robot_entry(robot: RobotSession) -> RobotEntry:
    running = robot.current_navigation.running
    here = current_place(robot)
    return RobotEntry(
        name=robot.name,
        path=f"/robots/{robot.name}",
        navigation=None if running is None else running.id,
        state=here.state,
        place=here.place,
        robot=robot_model(robot),
    )
