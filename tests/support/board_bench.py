"""A robot that sees a printed board, as somebody holds it, and tells another camera than it has."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import httpx
import msgspec
import numpy as np

from robot.devices.ports import CapturedFrame, DeviceSet
from shared.calibration import REFERENCE_ROBOT, CameraCalibration
from station.calibration.target_page import page_target
from tests.support.link import Bench, until
from tests.support.station import Desk, running_station
from tests.support.target_images import T_cam_board, photograph, printed_page

assert REFERENCE_ROBOT.camera is not None
TOLD = msgspec.structs.replace(REFERENCE_ROBOT.camera, width=320, height=240, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
BUILT: CameraCalibration = msgspec.structs.replace(
    TOLD, fx=331.0, fy=333.0, cx=163.5, cy=117.5, distortion=(-0.2, 0.05, 0.0, 0.0)
)
TARGET = page_target("aprilgrid", "A4")
# Rotation vector (rad), distance (m), shift of the board's middle in distances: to all sides, near, far, corners.
HELD: list[tuple[tuple[float, float, float], float, tuple[float, float]]] = [
    *(((0.0, y, 1.2), 0.55, (0.3 * y, 0.0)) for y in (-0.5, 0.0, 0.5)),
    *(((0.0, 0.0, 0.0), 0.42, (x, y)) for x in (-0.28, 0.28) for y in (-0.2, 0.2)),
    *(((x, y, 0.3), 0.34, (0.1 * y, 0.1 * x)) for x in (-0.5, 0.0, 0.5) for y in (-0.55, 0.0, 0.55)),
    *(((x, 0.0, -0.4), 0.28, (0.0, 0.15 * x)) for x in (-0.4, -0.1, 0.2, 0.4)),
]


class Showing:
    """Lets the bench's camera see the board as it is held now, some ten times a second."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        page = printed_page(TARGET)
        self._pictures = [_jpeg(photograph(page, BUILT, T_cam_board(TARGET, np.array(r), z, xy))) for r, z, xy in HELD]
        self.number = 0

    async def run(self) -> None:
        while True:
            frame = CapturedFrame(
                time.monotonic_ns(), 5_000_000, BUILT.width, BUILT.height, self._pictures[self.number]
            )
            self._bench.camera.frames.put_nowait(frame)
            self._bench.imu.inject_until(time.monotonic_ns())
            await asyncio.sleep(0.1)

    async def show_all(self, desk: Desk) -> None:
        """Each as it is held until it was looked at, as a person does who waits for the page."""
        for number in range(len(self._pictures)):
            self.number = number
            await looked_at(desk.http, time.monotonic_ns())


async def looked_at(http: httpx.AsyncClient, t_robot_ns: int) -> dict[str, Any]:
    """Until three pictures from this time on were looked at: one may be on its way, two show that it is still.

    Returns what the newest shows.
    """
    looks: set[int] = set()
    seen: dict[str, Any] | None = None
    while len(looks) < 3:
        sessions = (await http.get("/calibration/sessions")).json()  # none: it is just being begun
        seen = sessions[0]["seen"] if sessions else None
        if seen is not None and seen["t_robot_ns"] > t_robot_ns:
            looks.add(seen["t_robot_ns"])
        await asyncio.sleep(0.05)
    assert seen is not None
    return seen


def _jpeg(image: Any) -> bytes:
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])


class BoardBench(Bench):
    """A robot whose pictures are of a board, and that tells another camera than it has."""

    def devices(self) -> DeviceSet:
        return replace(super().devices(), calibration=msgspec.structs.replace(REFERENCE_ROBOT, camera=TOLD))


@contextlib.asynccontextmanager
async def before_a_board(tmp_path: Path) -> AsyncIterator[tuple[Desk, Bench, Showing]]:
    bench = BoardBench()
    await bench.start()
    showing = Showing(bench)
    task = asyncio.create_task(showing.run())
    try:
        async with running_station(bench.port, tmp_path) as desk:
            await until(lambda: desk.station.first.state.connected and desk.station.first.camera.newest)
            yield desk, bench, showing
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await bench.stop()
