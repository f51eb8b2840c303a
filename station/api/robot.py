"""/robot, driving, pan-tilt."""

from __future__ import annotations

import asyncio
import itertools
import time

from fastapi import APIRouter, WebSocket
from pydantic import ValidationError

from shared.bounded import shortened
from shared.errors import RobotSystemError
from shared.messages import MAX_DRIVE_TTL_MS
from shared.text import printable
from station.api.deps import DriverDep, RobotDep, StationDep, driver_name
from station.api.limits import converse, receive_text
from station.api.messages import (
    DriveAccepted,
    DriveCommand,
    DriveRefused,
    DriveReply,
    PanTiltCommand,
    ReleaseCommand,
    StopCommand,
    TakeOverCommand,
    TimeReply,
    drive_request,
)
from station.api.problems import kind_of, responses
from station.api.schema.base import Accepted
from station.api.schema.fleet import RobotEntry, robot_entry
from station.api.schema.robot import (
    DriveOrder,
    DriverModel,
    HijackOrder,
    PanTiltOrder,
    RobotModel,
    StopModel,
    robot_model,
)
from station.errors import NoRobot
from station.events import Event, MessageReader
from station.robots.driving import LateCommands
from station.robots.session import RobotSession

router = APIRouter(tags=["robot"])
itself = APIRouter(tags=["robot"])  # below /robot
of_robot = APIRouter(tags=["robot"])
TIME_PERIOD_S = 0.05  # a command's age is known no better than this
UNDATED_MS = 100  # a command without `heard_ms` may be old already, so it holds only for two repeats
_connections = itertools.count(1)


@router.get("/robots", summary="All robots of this station, the first one first")
async def robots(station: StationDep) -> list[RobotEntry]:
    """Calls without a robot's name mean the first one; `path` before a call means this one."""
    return [robot_entry(robot) for robot in station.robots.values()]


@itself.get("", summary="Link, battery, rates, losses, clock offset, who drives")
async def robot(robot: RobotDep) -> RobotModel:
    return robot_model(robot)


@of_robot.post("/drive", summary="Hold a velocity for ttl_ms", responses=responses(409, 503))
async def drive(order: DriveOrder, robot: RobotDep, driver: DriverDep) -> DriverModel:
    """Takes the wheel when it is free; a second of silence after ttl_ms gives it back. Repeat while it is to move."""
    robot.driving.drive(driver, order.linear, order.angular, order.ttl_ms)
    return _driver_model(robot, driver)


@of_robot.post("/drive/take-over", summary="Become the driver, whoever drives", responses=responses(409, 503))
async def take_over(robot: RobotDep, driver: DriverDep) -> DriverModel:
    """The robot is stopped when another one drove. The wheel is yours for six seconds, then as long as you drive."""
    robot.driving.take_over(driver)
    return _driver_model(robot, driver)


@of_robot.post("/drive/release", summary="Let go of the wheel")
async def release(robot: RobotDep, driver: DriverDep) -> DriverModel:
    robot.driving.release(driver)
    return _driver_model(robot, driver)


def _driver_model(robot: RobotSession, caller: str) -> DriverModel:
    driving = robot.driving
    now = driving.driver
    keeps_s = 0.0 if now is None else round(driving.lease_left_s, 1)
    return DriverModel(driver=now, you_drive=driving.has_wheel(caller), keeps_s=keeps_s)


@of_robot.post("/stop", summary="Motors off now", responses=responses(503))
async def stop(robot: RobotDep, driver: DriverDep) -> StopModel:
    """Anyone may stop the robot, also one who does not drive; then the driver must let go before driving on.

    Answers when the robot has confirmed it, and after 0.15 s when it has not: then the network is bad, or the
    connection dead and nobody knows yet. The stop is sent again over each new connection until it is confirmed.
    """
    if not robot.stop(driver):
        raise NoRobot(
            "no robot is connected; its own watchdog stops it when the link is lost, and STOP is its first word"
        )
    return StopModel(confirmed=await robot.stop_is_confirmed())


@of_robot.post("/pan-tilt", summary="Point the camera head", responses=responses(409, 503))
async def pan_tilt(order: PanTiltOrder, robot: RobotDep, driver: DriverDep) -> Accepted:
    robot.point(driver, order.pan, order.tilt)
    return Accepted()


@itself.post("/hijack", summary="Put a simulated robot down elsewhere", responses=responses(409, 503))
async def hijack(robot: RobotDep, order: HijackOrder | None = None) -> Accepted:
    """Only simulated ones. Without a spot the robot chooses one, in another room where there is one.

    Answers when the robot has taken it up; 422 with its words for a spot that is not free floor.
    """
    await robot.hijack(None if order is None else order.spot)
    return Accepted()


@of_robot.websocket("/ws/drive")
async def drive_socket(socket: WebSocket, robot: RobotDep, driver: str = "") -> None:
    """The joystick: commands in (`DriveRequest`), answers out (`DriveAnswer`). `?driver=` names who drives.

    When the socket closes, the robot stops if its driver drove. A command's `ttl_ms` counts from our `time` that it
    repeats, so an old one (a frozen network delivers the past in one burst) is passed over silently; when only old ones
    come for half a second, `refused` says so (problem `late`). One that repeats none cannot be told from a fresh one:
    it holds for 100 ms from its arrival at most.
    """
    # Two nameless pages of one computer are two drivers: one at a time.
    place = f"page at {socket.client.host}" if socket.client else "page"
    name = driver_name(driver) or f"{place} #{next(_connections)}"
    late = LateCommands()

    async def obey() -> None:
        await _obey(socket, robot, name, await receive_text(socket), late)

    def let_go() -> None:
        if robot.driving.driver == name:
            robot.driving.release(name)

    with robot.events.hub.subscribe() as changes:
        say = (lambda: _tell_driver(socket, robot, name, changes), lambda: _tell_time(socket))
        await converse(socket, obey, *say, leave=let_go)


async def _obey(socket: WebSocket, robot: RobotSession, name: str, text: str, late: LateCommands) -> None:
    try:
        command = drive_request.validate_json(text)
    except ValidationError as exc:
        await socket.send_text(DriveRefused(problem="invalid", text=_mistake(exc)).model_dump_json())
        return
    try:
        match command:
            case DriveCommand():
                now_ms = _now_ms()
                left_ms = life_left_ms(command, now_ms)
                if command.linear == command.angular == 0.0 and robot.driving.is_held_by(name):
                    # Never too late to stop what moves. Where nothing of ours moves, an old zero must not count: it
                    # would let go of a joystick that is held against somebody's stop.
                    left_ms = max(1, left_ms)
                if left_ms <= 0:
                    if (command.linear, command.angular) != (0.0, 0.0):
                        robot.driving.note_late(name)
                    if late.note_late(now_ms * 1_000_000):
                        await socket.send_text(too_late(command, now_ms).model_dump_json())
                    return
                late.note_fresh()
                age_ms = max(0, min(command.ttl_ms, MAX_DRIVE_TTL_MS) - left_ms)
                robot.driving.drive(name, command.linear, command.angular, left_ms, age_ms)
                await socket.send_text(DriveAccepted(seq=command.seq).model_dump_json())
            case StopCommand():
                robot.stop(name, command.reason)
            case PanTiltCommand():
                robot.point(name, command.pan, command.tilt)
            case TakeOverCommand():
                robot.driving.take_over(name)
            case ReleaseCommand():
                robot.driving.release(name)
    except RobotSystemError as exc:
        await socket.send_text(DriveRefused(problem=kind_of(exc)[0], text=str(exc)).model_dump_json())


def _mistake(exc: ValidationError) -> str:
    """The first one, with the field's name in front where it is one field's."""
    error = exc.errors()[0]
    field = ".".join(shortened(str(part)) for part in error["loc"][1:])  # behind the message's type
    return printable(f"{field}: {error['msg']}" if field else str(error["msg"]))


async def _tell_driver(socket: WebSocket, robot: RobotSession, name: str, changes: MessageReader[Event]) -> None:
    told: DriveReply | None = None
    while True:
        now = DriveReply(driver=robot.driving.driver, you_drive=robot.driving.has_wheel(name))
        if now != told:
            told = now
            await socket.send_text(now.model_dump_json())
        while (await changes.get()).kind not in ("driver", "robot"):  # the robot tells which station drives it
            pass


async def _tell_time(socket: WebSocket) -> None:
    while True:
        await socket.send_text(TimeReply(t_ms=_now_ms()).model_dump_json())
        await asyncio.sleep(TIME_PERIOD_S)


def life_left_ms(command: DriveCommand, now_ms: int) -> int:
    """How long a command may still hold; zero or less: it is over.

    At most MAX_DRIVE_TTL_MS from when it was said, so that a page whose link is cut without a word cannot keep the
    robot going.
    """
    ttl_ms = min(command.ttl_ms, MAX_DRIVE_TTL_MS)
    if command.heard_ms is None or command.heard_ms > now_ms:  # a time that was never told says nothing of its age
        return min(ttl_ms, UNDATED_MS)
    return ttl_ms - (now_ms - command.heard_ms)


def too_late(command: DriveCommand, now_ms: int) -> DriveRefused:
    """Why a page over a slow link cannot drive."""
    age_ms = now_ms - (command.heard_ms or 0)
    text = (
        f"the connection to the station is too slow for driving: commands are {age_ms} ms old when they arrive and hold"
        f" for {min(command.ttl_ms, MAX_DRIVE_TTL_MS)} ms; use a faster network or come closer"
    )
    return DriveRefused(problem="late", text=text)


def _now_ms() -> int:
    return time.monotonic_ns() // 1_000_000
