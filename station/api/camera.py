"""/camera and /ws/camera: the newest picture, to any number of viewers, each at its own pace."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncIterator

from fastapi import APIRouter, Response, WebSocket
from fastapi.responses import StreamingResponse

from station.api.deps import RobotDep
from station.api.limits import converse
from station.api.problems import responses
from station.api.streams import HEADER, STREAM, AcknowledgedPictures, SeatedStream, part_of_stream
from station.errors import NoRobot
from station.robots.session import RobotSession, SeenFrame

of_robot = APIRouter(tags=["camera"])

JPEG = {"content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}}, "description": "JPEG"}


@of_robot.get(
    "/camera/frame.jpg",
    summary="The newest picture",
    response_class=Response,
    responses={200: JPEG, **responses(503)},
)
async def frame(robot: RobotDep) -> Response:
    seen = _require(robot)
    age_s = _age_s(seen)
    headers = {"Cache-Control": "no-store", "X-Robot-Time-Ns": str(seen.frame.t_robot_ns)}
    if not math.isnan(age_s):
        headers["X-Age-S"] = f"{age_s:.3f}"
    return Response(seen.frame.jpeg, media_type="image/jpeg", headers=headers)


@of_robot.get(
    "/camera/stream.mjpg",
    summary="Pictures as multipart JPEG",
    response_class=StreamingResponse,
    responses={200: STREAM, **responses(503)},
)
async def stream(robot: RobotDep) -> StreamingResponse:
    """For viewers that know nothing else; /ws/camera is quicker."""
    _require(robot)
    return SeatedStream(_parts(robot), f"the stream of {robot.name}")


@of_robot.websocket("/ws/camera")
async def camera_socket(socket: WebSocket, robot: RobotDep) -> None:
    """Binary: a 32-byte header, then the JPEG. Answer each with any text; the next one is sent then, the newest."""
    pictures = AcknowledgedPictures(socket)
    await converse(socket, pictures.hear, lambda: _send_frames(pictures, robot))


async def _send_frames(pictures: AcknowledgedPictures, robot: RobotSession) -> None:
    with robot.camera.subscribe() as frames:
        while True:
            seen = await frames.get()
            skipped, frames.skipped = frames.skipped, 0
            await pictures.send(_packed(seen, skipped))


def _packed(seen: SeenFrame, skipped: int) -> bytes:
    f = seen.frame
    return HEADER.pack(f.seq & 0xFFFFFFFF, f.width, f.height, f.t_robot_ns, _age_s(seen), skipped, 0) + f.jpeg


async def _parts(robot: RobotSession) -> AsyncIterator[bytes]:
    with robot.camera.subscribe() as frames:
        while True:
            yield part_of_stream((await frames.get()).frame.jpeg)


def _age_s(seen: SeenFrame) -> float:
    return math.nan if seen.t_captured_ns is None else (time.monotonic_ns() - seen.t_captured_ns) * 1e-9


def _require(robot: RobotSession) -> SeenFrame:
    if robot.camera.newest is None:
        raise NoRobot("no picture has come yet; is a robot with a camera connected?")
    return robot.camera.newest
