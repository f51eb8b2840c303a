"""/ws/events and /log: what happens."""

from __future__ import annotations

from typing import cast

from fastapi import APIRouter, WebSocket

from station.api.deps import RobotDep
from station.api.limits import converse
from station.api.messages import (
    BinMessage,
    CalibrationMessage,
    DriverMessage,
    JobMessage,
    LandmarksMessage,
    LogMessage,
    MapMessage,
    NavigationMessage,
    PlaceMessage,
    PoseMessage,
    RobotMessage,
)
from station.api.schema.base import Model
from station.api.schema.calibration_session import session_model
from station.api.schema.jobs import JobModel
from station.api.schema.navigations import navigation_model
from station.api.schema.places import current_place, visit_model
from station.api.schema.robot import robot_model
from station.api.schema.slam import slam_model
from station.api.schema.station import LogModel
from station.events import Event, LogLine
from station.library.navigation_records import NavigationRecord
from station.robots.session import RobotSession

of_robot = APIRouter(tags=["events"])


@of_robot.get("/log", summary="What happened lately, oldest first")
async def log(robot: RobotDep) -> list[LogModel]:
    return [_log(line) for line in robot.events.log]


@of_robot.websocket("/ws/events")
async def events_socket(socket: WebSocket, robot: RobotDep) -> None:
    """JSON messages (`EventMessage`): first the state of everything, then each change. Nothing is read."""
    await converse(socket, socket.receive, lambda: _send_events(socket, robot))


async def _send_events(socket: WebSocket, robot: RobotSession) -> None:
    """To one page. A slow one gets only the newest of each state, since its mailbox holds no more."""
    with robot.events.hub.subscribe() as messages:
        while True:
            await socket.send_text(to_message(robot, await messages.get()).model_dump_json())


def to_message(robot: RobotSession, event: Event) -> Model:
    """What a page is told of an event."""
    live = robot.current_navigation.live
    active = robot.active_maps.first
    match event.kind:
        case "robot":
            return RobotMessage(robot=robot_model(robot))
        case "driver":
            return DriverMessage(driver=robot.driving.driver)
        case "pose":
            return PoseMessage(slam=slam_model(robot))
        case "landmarks":
            total = len(live.points) if live else 0
            return LandmarksMessage(
                navigation=live.navigation_id if live else None, source=live.source if live else None, total=total
            )
        case "navigation":
            navigation = cast(NavigationRecord | None, event.subject)
            return NavigationMessage(navigation=None if navigation is None else navigation_model(navigation))
        case "map":
            return MapMessage(
                active=active.place_map.id if active else None,
                revision=robot.active_maps.revision,
                has_plan=active is not None and active.place_map.plan is not None,
            )
        case "job":
            return JobMessage(job=JobModel.of(event.subject))
        case "place":
            current, last = robot.current_place, robot.current_place.visits.last
            return PlaceMessage(
                place=current_place(robot),
                visit=visit_model(last) if last is not None and current.report else None,
            )
        case "bin":
            return BinMessage()
        case "calibration":
            session = robot.guided_calibration.session
            return CalibrationMessage(session=None if session is None else session_model(session, robot))
        case "log":
            return LogMessage(line=_log(cast(LogLine, event.subject)))


def _log(line: LogLine) -> LogModel:
    return LogModel.of(line, unix_s=line.t_wall_s)
