"""Recorded navigations to look at again: their pictures at the pace they were taken, their cloud, their way."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, AsyncIterator
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Response, WebSocket
from fastapi.responses import StreamingResponse

from shared.errors import RobotSystemError
from station.api.deps import StationDep
from station.api.limits import converse
from station.api.points import BINARY, WantsPly, ply_response, points_response
from station.api.problems import kind_of, responses
from station.api.schema.jobs import JobModel
from station.api.schema.navigations import ReplayModel, ReprocessOrder, replay_model
from station.api.streams import HEADER, STREAM, AcknowledgedPictures, SeatedStream, part_of_stream
from station.app import Station
from station.errors import Conflict, OutOfRange
from station.files.navigation_folder import load_navigation
from station.model.navigation import Navigation
from station.model.points import pack_points
from station.recordings.playback import replay

router = APIRouter(tags=["navigations"])
FromS = Annotated[float, Query(ge=0, le=86_400, allow_inf_nan=False, description="seconds after the first picture")]
Speed = Annotated[float, Query(ge=0.1, le=16, allow_inf_nan=False, description="1: as it was")]
REFUSED = 4000  # close codes of /ws/replay: this plus the status that the same problem has over HTTP


@router.post(
    "/navigations/{navigation_id}/reprocess",
    summary="Run SLAM over a recording again",
    status_code=202,
    responses=responses(404, 409),
)
async def reprocess(navigation_id: str, station: StationDep, order: ReprocessOrder | None = None) -> JobModel:
    """For a navigation whose SLAM failed, or with another backend. Its navigation is replaced when the job is done."""
    return JobModel.of(station.reprocess(navigation_id, order.backend if order else None))


@router.get(
    "/navigations/{navigation_id}/landmarks",
    summary="A finished navigation's cloud",
    response_class=Response,
    responses={200: BINARY, **responses(404, 409)},
)
async def landmarks(navigation_id: str, station: StationDep, is_ply: WantsPly = False) -> Response:
    cloud = (await _load(station, navigation_id)).landmarks
    if is_ply:
        return await ply_response(cloud.p_world, cloud.rgb, navigation_id, navigation_id)
    table = await asyncio.to_thread(pack_points, cloud.p_world, cloud.rgb)
    return points_response(table, 0, len(cloud), navigation_id)


@router.get(
    "/navigations/{navigation_id}/replay",
    summary="Where the camera was during a finished navigation",
    responses=responses(404, 409),
)
async def poses(
    navigation_id: str, station: StationDep, limit: Annotated[int, Query(ge=2, le=20_000)] = 2000
) -> ReplayModel:
    return replay_model(navigation_id, await _load(station, navigation_id), limit)


@router.get(
    "/navigations/{navigation_id}/replay.mjpg",
    summary="A recorded navigation's pictures as multipart JPEG, at their own pace",
    response_class=StreamingResponse,
    responses={200: STREAM, **responses(404, 409, 503)},
)
async def stream(navigation_id: str, station: StationDep, from_s: FromS = 0.0, speed: Speed = 1.0) -> StreamingResponse:
    parts = _parts(_recording(station, navigation_id, from_s), from_s, speed)
    first = await anext(parts, None)
    if first is None:
        raise OutOfRange(f"{navigation_id} has no picture from {from_s:g} s on; give a smaller from_s")
    return SeatedStream(_chained(first, parts), "recorded navigations")


@router.websocket("/ws/replay")
async def replay_socket(
    socket: WebSocket, station: StationDep, navigation: str, from_s: FromS = 0.0, speed: Speed = 1.0
) -> None:
    """As /ws/camera, but `age_s` counts from the first picture: a 32-byte header, then the JPEG; answer each one.

    The socket is closed after the last one.
    """
    shown = AcknowledgedPictures(socket)

    async def play() -> None:
        try:
            path = _recording(station, navigation, from_s)
            async with contextlib.aclosing(replay(path, from_s, speed)) as pictures:
                async for p in pictures:
                    header = HEADER.pack(p.number & 0xFFFFFFFF, 0, 0, p.t_robot_ns, p.since_first_s, 0, 0)
                    await shown.send(header + p.jpeg)
        except RobotSystemError as exc:
            await socket.close(REFUSED + kind_of(exc)[2], str(exc)[:120])
        else:
            await socket.close()

    await converse(socket, shown.hear, play)


async def _chained(first: bytes, rest: AsyncGenerator[bytes]) -> AsyncIterator[bytes]:
    async with contextlib.aclosing(rest):
        yield first
        async for part in rest:
            yield part


async def _parts(path: Path, from_s: float, speed: float) -> AsyncGenerator[bytes]:
    async with contextlib.aclosing(replay(path, from_s, speed)) as pictures:
        async for picture in pictures:
            yield part_of_stream(picture.jpeg)


def _recording(station: Station, navigation_id: str, from_s: float) -> Path:
    """Raises Unknown, Conflict, or OutOfRange for a time after its end."""
    navigation = station.navigations.library.get(navigation_id)
    path = station.navigations.library.folder(navigation_id) / "recording.mcap"
    if navigation.state == "recording" or not path.is_file():
        raise Conflict(f"{navigation.name} has no recording to play now (it is {navigation.state})")
    if from_s >= navigation.duration_s > 0:
        raise OutOfRange(
            f"from_s {from_s:g} is after the last picture: {navigation_id} lasts {navigation.duration_s:.1f} s"
        )
    return path


async def _load(station: Station, navigation_id: str) -> Navigation:
    station.navigations.ready(navigation_id)
    return await asyncio.to_thread(load_navigation, station.navigations.library.navigation_folder(navigation_id))
