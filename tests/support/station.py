"""A station with its API on a free port, in the test's event loop; workers with made-up SLAM and localisation."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import httpx
import numpy as np

from robot.devices.ports import CapturedFrame
from shared.listening import bind
from station.api.server import make_api
from station.api.serving import serve
from station.app import Station
from station.config import AccessConfig, ApiConfig, LocalizationConfig, RobotConfig, SlamConfig, StationConfig
from station.maps.store import MapStore
from station.model.floor_plan import NameSuggestion
from station.model.place_map import PlaceMap
from station.places.making.build import build_map
from station.places.rooms.edits import with_room_split
from station.places.rooms.planning import planned
from station.workers.place_interface import PlaceProgram
from station.workers.request import ProgramName
from tests.support.link import Bench, until
from tests.support.made_up_workers import PlaceByLight, made_up_navigation
from tests.support.plans import two_rooms

STRAIGHT_SLAM = "tests.support.made_up_workers:StraightSlam"
FRAME_S = 0.05
DRAWN = np.array([[2.0, -1.0], [2.0, 5.0]])  # right across the made-up room


def store_map(data_dir: Path) -> PlaceMap:
    """A map of a made-up room, in the station's store."""
    place_map = build_map(made_up_navigation(), name="Made-up room")
    MapStore(data_dir / "maps").save(place_map)
    return place_map


def store_planned_map(data_dir: Path) -> PlaceMap:
    """The same with a floor plan of two rooms, of which one has a suggested name."""
    place_map = build_map(made_up_navigation(), name="Made-up room")
    rooms = dict.fromkeys((place.id for place in place_map.places), "room-l")
    suggestion = NameSuggestion("room-k", "Kitchen", "sticker", 0.98, "a sticker says so", 0)
    with_plan = replace(place_map, plan=replace(two_rooms(), room_of_place=rooms), suggestions=(suggestion,))
    MapStore(data_dir / "maps").save(with_plan)
    return with_plan


def store_split_map(data_dir: Path) -> PlaceMap:
    """A map whose plan is its own: the made-up room parted by a door that somebody drew. One has a suggested name."""
    place_map = with_room_split(planned(build_map(made_up_navigation(), name="Made-up room")), DRAWN)
    assert place_map.plan is not None and len(place_map.plan.rooms) == 2
    suggestion = NameSuggestion(place_map.plan.rooms[1].id, "Kitchen", "sticker", 0.98, "a sticker says so", 0)
    place_map = replace(place_map, suggestions=(suggestion,))
    MapStore(data_dir / "maps").save(place_map)
    return place_map


def picture(number: int, colour: tuple[int, int, int] | None = None) -> bytes:
    """A JPEG with its number."""
    image = np.full((480, 640, 3), colour or (60 + number % 3 * 20, 90, 40), np.uint8)
    cv2.putText(image, str(number), (200, 300), cv2.FONT_HERSHEY_SIMPLEX, 4, (255, 255, 255), 8)
    ok, encoded = cv2.imencode(".jpg", image)
    assert ok
    return encoded.tobytes()


class Film:
    """Gives a bench's camera 20 pictures a second and the IMU its samples, while it runs."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._pictures = [picture(n) for n in range(5)]
        self._runs = asyncio.Event()
        self._runs.set()
        self.count = 0

    def pause(self) -> None:
        self._runs.clear()

    def turn_the_light_out(self) -> None:
        """From now on the pictures are dark: another place, for PlaceByLight."""
        self._pictures = [picture(n, (4, 4, 4)) for n in range(5)]

    def go_on(self) -> None:
        self._runs.set()

    async def run(self) -> None:
        while True:
            await self._runs.wait()
            jpeg = self._pictures[self.count % len(self._pictures)]
            self._bench.camera.frames.put_nowait(CapturedFrame(time.monotonic_ns(), 5_000_000, 640, 480, jpeg))
            self._bench.imu.inject_until(time.monotonic_ns())
            self.count += 1
            await asyncio.sleep(FRAME_S)


@dataclass
class Desk:
    """A running station and how to reach it."""

    station: Station
    address: str
    http: httpx.AsyncClient

    def socket(self, path: str) -> str:
        return self.address.replace("http", "ws") + path


@asynccontextmanager
async def running_station(
    robot_port: int | tuple[int, ...],
    data_dir: Path,
    *,
    backend: str = STRAIGHT_SLAM,
    verify: ssl.SSLContext | None = None,
    place_program: type[PlaceProgram] = PlaceByLight,
) -> AsyncIterator[Desk]:
    """Serve a station that looks for its robot(s) at this port; with `verify` by TLS, and with access control."""
    config = StationConfig(
        data_dir=data_dir,
        robots=tuple(
            RobotConfig("127.0.0.1", p) for p in ((robot_port,) if isinstance(robot_port, int) else robot_port)
        ),
        api=ApiConfig(port=0),
        access=AccessConfig(on_loopback=verify is not None),
        slam=SlamConfig(backend=backend),
        localization=LocalizationConfig(rate_hz=4),
    )
    station = Station(config, place_program=ProgramName.of(place_program))
    listener = bind(config.api.host, config.api.port)
    address = f"{'https' if verify else 'http'}://127.0.0.1:{listener.getsockname()[1]}"
    started = asyncio.Event()
    serving = asyncio.create_task(serve(station, make_api(station), listener, started.set))
    # No connection is used twice: one that rested for 5 s may be closed by the server just as the next call is sent.
    fresh = httpx.Limits(max_keepalive_connections=0)
    # Without TLS there is nothing to verify, and reading the authorities' certificates takes 0.06 s of CPU time.
    async with httpx.AsyncClient(base_url=address, timeout=90.0, limits=fresh, verify=verify or False) as http:
        try:
            await until(lambda: started.is_set() or serving.done())
            yield Desk(station, address, http)
        finally:
            if serving.done():
                await serving
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            listener.close()
