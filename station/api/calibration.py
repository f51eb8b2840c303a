"""/calibration: what a robot tells of its sensors, and another in its place."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse

from shared.calibration import Calibration
from shared.calibration_yaml import calibration_text
from shared.messages import Hello
from station.api.deps import RobotDep, StationDep
from station.api.problems import responses
from station.api.schema.calibration import CalibrationModel, CalibrationOrder, calibration_model, ordered_calibration
from station.api.schema.calibration_session import (
    CalibrationSessionModel,
    SessionOrder,
    calibration_by_result,
    ordered_board,
    session_model,
)
from station.api.schema.jobs import JobModel
from station.calibration.camera_files import camchain_yaml
from station.calibration.target import TargetKind
from station.errors import NoRobot, NotCapable, Unknown
from station.workers.calibration_interface import RECORDING, RESIDUALS, RESULT, PaperSize

router = APIRouter(tags=["calibration"])
of_robot = APIRouter(tags=["calibration"])
PDF: dict[str, Any] = {"content": {"application/pdf": {"schema": {"type": "string", "format": "binary"}}}}
FILES = {RECORDING: "application/octet-stream", RESULT: "application/json", RESIDUALS: "image/png"}
FILE_CONTENT: dict[str, Any] = {
    "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in FILES.values()}
}
YAML: dict[str, Any] = {"content": {"application/yaml": {"schema": {"type": "object"}}}}


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
        name, text = "camchain-imucam.yaml", camchain_yaml(hello.calibration.camera)
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}
    return Response(text, media_type="application/yaml", headers=headers)


@of_robot.post("/calibration/use", summary="Let the robot tell other numbers", responses=responses(404, 409, 503))
async def use(order: CalibrationOrder, robot: RobotDep) -> CalibrationModel:
    """What is left out stays. The robot keeps the numbers before these (`/calibration/undo`), and these over a restart.

    409 while it drives or a navigation is recorded, and for a result that rests on numbers which were replaced since;
    422 with its words for numbers that cannot be its own.
    """

    def completed(hello: Hello) -> Calibration:
        if order.session is None:
            return ordered_calibration(hello.calibration, order)
        return calibration_by_result(robot.guided_calibration.get_for(hello, order.session), hello.calibration)

    await robot.use_calibration(completed)
    return calibration_model(robot)


@of_robot.post("/calibration/undo", summary="Let it tell the numbers before these", responses=responses(409, 503))
async def undo(robot: RobotDep) -> CalibrationModel:
    """Undone twice is done again."""
    await robot.use_calibration(None)
    return calibration_model(robot)


@router.get(
    "/calibration/target.pdf",
    summary="A board to print",
    response_class=Response,
    responses={200: PDF, **responses(409)},
)
async def target(
    station: StationDep,
    kind: Annotated[TargetKind, Query()] = "aprilgrid",
    size: Annotated[PaperSize, Query()] = "A4",
) -> Response:
    """One page at its true scale, with a ruler to check the printer's. Glue it onto something flat."""
    page = await station.target_page(kind, size)
    headers = {"Content-Disposition": f'inline; filename="calibration-{kind}-{size}.pdf"'}
    return Response(page, media_type="application/pdf", headers=headers)


@of_robot.get("/calibration/sessions", summary="The newest guided calibration")
async def sessions(robot: RobotDep) -> list[CalibrationSessionModel]:
    """None or one. While a board is looked at, /ws/events tells it a few times a second."""
    session = robot.guided_calibration.session
    return [] if session is None else [session_model(session, robot)]


@of_robot.post(
    "/calibration/sessions", summary="Begin a guided calibration", status_code=201, responses=responses(409, 503)
)
async def begin(order: SessionOrder, robot: RobotDep) -> CalibrationSessionModel:
    """From now on what the robot sends is recorded, and the board is looked for in its newest pictures."""
    board = None if order.target is None else ordered_board(order.target)
    return session_model(await robot.start_calibration(order.kind, board), robot)


@of_robot.get("/calibration/sessions/{session_id}", summary="One guided calibration", responses=responses(404))
async def session(session_id: str, robot: RobotDep) -> CalibrationSessionModel:
    return session_model(robot.guided_calibration.get(session_id), robot)


@of_robot.post(
    "/calibration/sessions/{session_id}/finish",
    summary="Estimate from what was seen",
    status_code=202,
    responses=responses(404, 409),
)
async def finish(session_id: str, robot: RobotDep, station: StationDep) -> JobModel:
    """Ends the recording. Follow GET /jobs/{id}; then the session has the result."""
    return JobModel.of(await station.finish_calibration(robot, session_id))


@of_robot.delete(
    "/calibration/sessions/{session_id}", summary="Give it up", status_code=204, responses=responses(404, 409)
)
async def give_up(session_id: str, robot: RobotDep) -> None:
    """Its recording goes, too. What the robot tells stays as it is."""
    await robot.guided_calibration.give_up(session_id)


@of_robot.get(
    "/calibration/sessions/{session_id}/{name}",
    summary="What was recorded, the result, its residuals",
    response_class=FileResponse,
    responses={200: FILE_CONTENT, **responses(404)},
)
async def session_file(
    session_id: str, name: Literal["recording.mcap", "result.json", "residuals.png"], robot: RobotDep
) -> FileResponse:
    path = robot.guided_calibration.get(session_id).folder / name
    if not path.is_file():
        raise Unknown(f"this calibration has no {name} yet")
    return FileResponse(path, media_type=FILES[name], headers={"X-Content-Type-Options": "nosniff"})
