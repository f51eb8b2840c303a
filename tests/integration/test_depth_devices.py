"""Depth on its way: devices, link, recording, SLAM."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

import station.robots.link
from robot.devices.ports import CapturedDepth, DepthSensor, DeviceSet
from robot.devices.recorded import open_recorded
from robot.devices.simulated import open_simulated
from robot.simulation.config import DepthSensorModel, SimulationConfig
from shared.calibration import REFERENCE_ROBOT, Calibration
from shared.messages import Depth, Hello, Join
from station.datasets import open_dataset
from station.model.frames import DepthFrame
from station.recordings.recorder import Recorder
from tests.support.depth import depth_camera, encoded
from tests.support.depth_robot import DepthBench, running_robot_with_depth
from tests.support.link import linked, until
from tests.support.recordings import HELLO, START_NS, frame

SENSOR = depth_camera(32, 24)
WITH_DEPTH = msgspec.structs.replace(REFERENCE_ROBOT, depth=SENSOR)
WAIT_S = 90.0


@pytest.fixture
async def bench() -> Any:
    async with running_robot_with_depth(SENSOR) as made:
        yield made


async def test_depth_reaches_the_station_as_the_sensor_made_it(bench: DepthBench) -> None:
    async with linked(bench.port) as (_, notes):
        assert notes.hellos[0].calibration.depth_sensor == SENSOR
        for t_ns in (5, 7):
            bench.depth.pictures.put_nowait(CapturedDepth(t_ns, bytes([t_ns]) * 1000))
            await until(lambda t_ns=t_ns: notes.depth and notes.depth[-1].t_robot_ns == t_ns)
        assert [(d.seq, d.t_robot_ns, d.png[:1], len(d.png)) for d in notes.depth] == [
            (0, 5, b"\x05", 1000),
            (1, 7, b"\x07", 1000),
        ]


async def test_an_older_station_gets_none_and_stays(bench: DepthBench, monkeypatch: pytest.MonkeyPatch) -> None:
    def older_join(**fields: Any) -> Join:
        return Join(**fields | {"knows_depth": False})

    monkeypatch.setattr(station.robots.link, "Join", older_join)
    async with linked(bench.port) as (link, notes):
        bench.depth.pictures.put_nowait(CapturedDepth(5, bytes(1000)))
        await until(bench.depth.pictures.empty)
        bench.camera.put(9)
        await until(lambda: notes.frames and len(notes.statuses) > 1)
        assert notes.depth == [] and link.state.connections == 1


async def test_an_older_station_that_gives_another_calibration_takes_no_sensor_away(bench: DepthBench) -> None:
    async with linked(bench.port) as (link, notes):
        without = msgspec.structs.replace(REFERENCE_ROBOT, gravity=9.8)  # it knows of no depth
        assert await link.commands.use_calibration(without, WITH_DEPTH) is None
        await until(lambda: notes.calibrations)
        assert notes.calibrations[-1].calibration == msgspec.structs.replace(WITH_DEPTH, gravity=9.8)


async def test_a_picture_too_large_is_a_fault_and_is_not_sent(bench: DepthBench) -> None:
    async with linked(bench.port) as (_, notes):
        bench.depth.pictures.put_nowait(CapturedDepth(5, bytes(2**20 + 1)))
        await until(lambda: any("too large to send" in n.message for n in notes.notices))
        assert notes.depth == []
        bench.depth.pictures.put_nowait(CapturedDepth(6, bytes(2**20)))
        await until(lambda: len(notes.depth) == 1)


def recording(path: Path, hello: Hello) -> Path:
    """Ten images and five depth pictures."""
    recorder = Recorder(path, min_free_bytes=0)
    recorder.on_connected(hello)
    for n in range(10):
        if n % 2 == 0:
            png = encoded(np.full((24, 32), 1000 + n, np.uint16))
            recorder.on_depth(Depth(seq=n, t_robot_ns=START_NS + n * 50_000_000 - 1, png=png))
        recorder.on_frame(frame(n), n)
    assert recorder.close().error == ""
    return path


def told(calibration: Calibration) -> Hello:
    return msgspec.structs.replace(HELLO, calibration=calibration)


def test_a_recording_gives_depth_back(tmp_path: Path) -> None:
    data = open_dataset(recording(tmp_path / "a.mcap", told(WITH_DEPTH)))
    found = [e for e in data.events() if isinstance(e, DepthFrame)]
    assert [e.t_robot_ns - START_NS for e in found] == [n * 50_000_000 - 1 for n in range(0, 10, 2)]
    assert [int(e.millimetres()[3, 4]) for e in found] == [1000, 1002, 1004, 1006, 1008]
    assert {e.sensor for e in found} == {SENSOR}
    part = open_dataset(tmp_path / "a.mcap", first=1, last=6)
    depth = [e for e in part.events() if isinstance(e, DepthFrame)]
    assert [int(e.millimetres()[0, 0]) for e in depth] == [1002, 1004, 1006]


def test_depth_of_a_sensor_nobody_tells_of_is_left_out(tmp_path: Path) -> None:
    data = open_dataset(recording(tmp_path / "a.mcap", told(REFERENCE_ROBOT)))
    assert data.read_depth is None
    assert len(list(data.events())) == 10


def play(path: Path) -> DeviceSet:
    return open_recorded(path, speed=20.0)


def a_recording(folder: Path) -> DeviceSet:
    return play(recording(folder / "a.mcap", told(WITH_DEPTH)))


def a_folder(folder: Path) -> DeviceSet:
    (folder / "camera-intrinsics.txt").write_text("50 0 31.5\n0 50 23.5\n0 0 1\n")
    (folder / "depth-intrinsics.txt").write_text("30 0 15.5\n0 30 11.5\n0 0 1\n")
    for n in range(6):
        jpeg = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
        (folder / f"frame-{n:06d}.color.jpg").write_bytes(jpeg)
        if n % 2 == 0:
            (folder / f"frame-{n:06d}.depth.png").write_bytes(encoded(np.full((24, 32), 1500, np.uint16)))
    return play(folder)


def simulated(_folder: Path) -> DeviceSet:
    return open_simulated("room", 1, config=SimulationConfig(depth=DepthSensorModel(rate_hz=10.0, noise=0.0)))


@pytest.mark.parametrize(("adapter", "size"), [(a_recording, (32, 24)), (a_folder, (32, 24)), (simulated, (64, 48))])
async def test_every_depth_sensor_gives_pictures_of_its_calibration_in_time_order(
    adapter: Any, size: tuple[int, int], tmp_path: Path
) -> None:
    devices: DeviceSet = adapter(tmp_path)
    sensor, depth = devices.calibration.depth_sensor, devices.depth
    assert depth is not None and sensor is not None and (sensor.width, sensor.height) == size
    try:
        taken = [await measure(depth) for _ in range(3)]
    finally:
        await devices.close()
    assert all(a.t_robot_ns < b.t_robot_ns for a, b in pairwise(taken))
    for one in taken:
        millimetres = DepthFrame(one.t_robot_ns, one.png, sensor).millimetres()
        assert (millimetres > 0).mean() > 0.5
        assert 100 < np.median(millimetres[millimetres > 0]) < 6000


async def measure(depth: DepthSensor) -> CapturedDepth:
    return await asyncio.wait_for(depth.measure(), WAIT_S)


def test_a_simulated_robot_without_depth_is_what_it_was() -> None:
    devices = open_simulated("room", 1)
    assert devices.depth is None and devices.calibration.depth_sensor is None
    asyncio.run(devices.close())
