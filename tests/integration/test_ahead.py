"""What is ahead of the robot, from its sensor to the station's answer, over real sockets."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robot.devices.pi.hc_sr04 import calibration_of
from robot.devices.ports import CapturedDepth
from shared.pictures import depth_png
from tests.support.depth_robot import running_robot_with_depth
from tests.support.link import running_robot, until
from tests.support.station import running_station

SONAR = calibration_of((0.2, 0.0, 0.0))


def heard(t_ns: int, millimetres: int) -> CapturedDepth:
    return CapturedDepth(t_ns, depth_png(np.array([[millimetres]], dtype=np.uint16)))


async def test_the_station_says_how_far_the_next_thing_ahead_is(tmp_path: Path) -> None:
    async with running_robot_with_depth(SONAR) as bench, running_station(bench.port, tmp_path) as desk:
        session = desk.station.first
        await until(lambda: session.ahead.has_sensor)
        assert (await desk.http.get("/robot")).json()["ahead"] == {"distance_m": None, "age_s": None}
        for t_ns, millimetres, metres in ((1, 820, 0.82), (2, 0, None)):
            bench.depth.pictures.put_nowait(heard(t_ns, millimetres))
            await until(lambda m=metres: session.ahead.newest and session.ahead.newest.distance_m == m)
            answer = (await desk.http.get("/robot")).json()["ahead"]
            assert answer["distance_m"] == metres
            assert answer["age_s"] is None or answer["age_s"] >= 0  # None: this machine took 1.5 s for the question


async def test_a_robot_without_such_a_sensor_has_nothing_ahead(tmp_path: Path) -> None:
    async with running_robot() as bench, running_station(bench.port, tmp_path) as desk:
        await until(lambda: desk.station.first.state.connected)
        assert (await desk.http.get("/robot")).json()["ahead"] is None
