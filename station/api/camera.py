"""/camera and /ws/camera: the newest picture, to any number of viewers, each at its own pace."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
import time
from collections.abc import AsyncIterator

from fastapi import APIRouter, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from station.api.deps import RobotDep
from station.api.limits import MAX_STREAMS, Seats, receive_text, refuse, seated
from station.api.problems import responses
from station.errors import Busy, NoRobot
from station.robots.session import RobotSession, SeenFrame

of_robot = APIRouter(tags=["camera"])

# Little endian: seq u32, width u16, height u16, t_robot_ns i64, age_s f64 (NaN: clocks unknown), skipped u32, 0 u32.
HEADER = struct.Struct("<IHHqdII")
BOUNDARY = b"sentinel-frame"
JPEG = {"content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}}, "description": "JPEG"}
STREAM = {"content": {"multipart/x-mixed-replace": {}}, "description": "JPEGs, one after the other"}


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


class SeatedStream(StreamingResponse):
    """Multipart JPEG that keeps one of its kind's seats as long as it is sent."""

    def __init__(self, parts: AsyncIterator[bytes], kind: str) -> None:
        super().__init__(parts, media_type=f"multipart/x-mixed-replace; boundary={BOUNDARY.decode()}")
        self._kind = kind

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        seats: Seats = scope["app"].state.seats
        with seats.take(self._kind, MAX_STREAMS):
            await super().__call__(scope, receive, send)


@of_robot.websocket("/ws/camera")
async def camera_socket(socket: WebSocket, robot: RobotDep) -> None:
    """Binary: a 32-byte header, then the JPEG. Answer each with any text; the next one is sent then, the newest."""
    await socket.accept()
    try:
        with seated(socket):
            await _show(socket, robot)
    except Busy as exc:
        await refuse(socket, exc)


async def _show(socket: WebSocket, robot: RobotSession) -> None:
    acknowledged = asyncio.Event()
    sending = asyncio.create_task(_send_frames(socket, robot, acknowledged))
    try:
        while True:
            await receive_text(socket)
            acknowledged.set()
    except (WebSocketDisconnect, RuntimeError):
        return
    finally:
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sending


async def _send_frames(socket: WebSocket, robot: RobotSession, acknowledged: asyncio.Event) -> None:
    with robot.camera.subscribe() as frames:
        while True:
            seen = await frames.get()
            skipped, frames.skipped = frames.skipped, 0
            acknowledged.clear()
            await socket.send_bytes(_packed(seen, skipped))
            await acknowledged.wait()


def _packed(seen: SeenFrame, skipped: int) -> bytes:
    f = seen.frame
    return HEADER.pack(f.seq & 0xFFFFFFFF, f.width, f.height, f.t_robot_ns, _age_s(seen), skipped, 0) + f.jpeg


async def _parts(robot: RobotSession) -> AsyncIterator[bytes]:
    with robot.camera.subscribe() as frames:
        while True:
            jpeg = (await frames.get()).frame.jpeg
            head = b"--%s\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % (BOUNDARY, len(jpeg))
            yield head + jpeg + b"\r\n"


def _age_s(seen: SeenFrame) -> float:
    return math.nan if seen.t_captured_ns is None else (time.monotonic_ns() - seen.t_captured_ns) * 1e-9


def _require(robot: RobotSession) -> SeenFrame:
    if robot.camera.newest is None:
        raise NoRobot("no picture has come yet; is a robot with a camera connected?")
    return robot.camera.newest
