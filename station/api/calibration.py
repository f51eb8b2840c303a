"""/calibration: what a robot tells of its sensors, and another in its place."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response

from shared.calibration_yaml import calibration_text
from station.api.deps import RobotDep
from station.api.problems import responses
from station.api.schema.calibration import (
    CalibrationModel,
    CalibrationOrder,
    calibration_model,
    ordered_calibration,
)
from station.errors import NoRobot, NotCapable
from station.files.kalibr import camchain_text

of_robot = APIRouter(tags=["calibration"])
YAML: dict[str, Any] = {"content": {"application/yaml": {"schema": {"type": "string"}}}}


@of_robot.get("/calibration", summary="What the robot tells of its sensors", responses=responses(503))
async def calibration(robot: RobotDep) -> CalibrationModel:
    return calibration_model(robot)


@of_robot.get(
    "/calibration/file",
    summary="The same as a file",
    response_class=Response,
    responses={200: YAML, **responses(409, 503)},
)
async def file(robot: RobotDep, format: Annotated[Literal["yaml", "camchain"], Query()] = "yaml") -> Response:
    """`yaml`: the robot's calibration.yaml; `camchain`: kalibr's, of the camera and where it sits on the IMU."""
    hello = robot.state.hello
    if hello is None:
        raise NoRobot("no robot is connected; there is no calibration to fetch")
    name, text = "calibration.yaml", calibration_text(hello.calibration)
    if format == "camchain":
        if hello.calibration.camera is None:
            raise NotCapable("the robot has no camera, and a camera chain is of cameras")
        name, text = "camchain-imucam.yaml", camchain_text(hello.calibration.camera)
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}
    return Response(text, media_type="application/yaml", headers=headers)


@of_robot.post("/calibration/use", summary="Let the robot tell other numbers", responses=responses(409, 503))
async def use(order: CalibrationOrder, robot: RobotDep) -> CalibrationModel:
    """What is left out stays. The robot keeps the numbers before these (`/calibration/undo`), and these over a restart.

    409 while it drives or a navigation is recorded, 422 with its words for numbers that cannot be its own.
    """
    hello = robot.state.hello
    if hello is None:
        raise NoRobot("no robot is connected")
    await robot.use_calibration(ordered_calibration(hello.calibration, order))
    return calibration_model(robot)


@of_robot.post("/calibration/undo", summary="Let it tell the numbers before these", responses=responses(409, 503))
async def undo(robot: RobotDep) -> CalibrationModel:
    """Undone twice is done again."""
    await robot.use_calibration(None)
    return calibration_model(robot)
