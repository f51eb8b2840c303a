"""A robot that films and a station that is connected to it; how to ask and listen."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import websockets

from shared.calibration import REFERENCE_ROBOT, Calibration
from station.files.navigation_folder import save_navigation
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.workers.place_interface import PlaceProgram
from tests.support.link import Bench, running_robot, until
from tests.support.made_up_workers import PlaceByLight, made_up_navigation
from tests.support.station import STRAIGHT_SLAM, Desk, Film, running_station


@asynccontextmanager
async def at_work(
    tmp_path: Path,
    calibration: Calibration = REFERENCE_ROBOT,
    place_program: type[PlaceProgram] = PlaceByLight,
    backend: str = STRAIGHT_SLAM,
) -> AsyncIterator[tuple[Desk, Bench, Film]]:
    """A robot that films, and a station that is connected to it."""
    async with (
        running_robot(calibration=calibration) as bench,
        running_station(bench.port, tmp_path, place_program=place_program, backend=backend) as desk,
    ):
        film = Film(bench)
        filming = asyncio.create_task(film.run())
        try:
            await until(lambda: desk.station.first.state.connected and desk.station.first.camera.newest)
            yield desk, bench, film
        finally:
            filming.cancel()
            await asyncio.gather(filming, return_exceptions=True)


async def drive_off(bench: Bench, order: Callable[[], Awaitable[object]]) -> None:
    """Repeat an order, as a held joystick does, until the motors run: the robot passes over a station's first words."""
    while not bench.motors.history or bench.motors.are_off:
        await order()
        await asyncio.sleep(0.02)


async def wait_for(desk: Desk, path: str, condition: Any) -> Any:
    """Ask until the answer is as wanted."""
    while True:
        answer = (await desk.http.get(path)).json()
        if condition(answer):
            return answer
        await asyncio.sleep(0.05)


async def heard(socket: websockets.ClientConnection) -> Any:
    """The next answer on the drive socket; the clock, which ticks all the time, is passed over."""
    while (answer := json.loads(await socket.recv()))["type"] == "time":
        continue
    return answer


def is_problem(answer: Any, status: int) -> bool:
    document = answer.json()
    return (
        answer.status_code == status
        and answer.headers["content-type"] == "application/problem+json"
        and document["status"] == status
        and len(document["detail"]) > 5
        and document["type"].startswith("/problems/")
    )


def keep_navigation(data_dir: Path, navigation_id: str) -> NavigationRecord:
    """A finished navigation without a recording."""
    library = NavigationLibrary(data_dir / "navigations")
    navigation = NavigationRecord(
        navigation_id, f"Drive {navigation_id}", "ready", 1.0, "sfm", landmarks=5, scale="metric"
    )
    library.store(navigation)
    save_navigation(made_up_navigation(), library.navigation_folder(navigation_id))
    return navigation
