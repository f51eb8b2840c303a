"""An OAK-D as depth sensor, against a stand-in for its vendor's library."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from robot.config import PiConfig
from robot.devices.pi import adapter, oak_d
from robot.devices.pi.oak_d import OakD
from shared.errors import DeviceLost, DeviceUnavailable
from shared.geometry import transform
from station.model.frames import DepthFrame
from tests.support import depthai_stub
from tests.support.depthai_stub import Oak

AHEAD = ((0.2, 0.0, 0.05), 0.0)
WAIT_S = 20.0
NOTHING_ELSE = {"camera": False, "imu": False, "motors": "none", "pan_tilt": "none", "battery": "none"}


@pytest.fixture
def oak() -> Iterator[type[Oak]]:
    with depthai_stub.installed() as plugged_in:
        yield plugged_in


async def test_a_picture_is_thinned_with_its_calibration(oak: type[Oak]) -> None:
    v, u = np.mgrid[0:400, 0:640]
    oak.millimetres = (1000 + v + 2 * u).astype(np.uint16)
    camera = OakD(*AHEAD)
    try:
        depth = await asyncio.wait_for(camera.measure(), WAIT_S)
    finally:
        await camera.close()
    sensor = camera.calibration
    assert (sensor.width, sensor.height) == (320, 200) and not sensor.is_cone and not sensor.is_measured
    assert (sensor.fx, sensor.fy, sensor.cx, sensor.cy) == (200.0, 201.0, 160.5, 99.5)
    picture = DepthFrame(depth.t_robot_ns, depth.png, sensor).millimetres()
    assert (picture == oak.millimetres[::2, ::2]).all()


async def test_its_time_is_the_middle_of_its_exposure_by_our_clock(oak: type[Oak]) -> None:
    oak.age_s = 5.0
    begun_ns = time.monotonic_ns()
    camera = OakD(*AHEAD)
    try:
        depth = await asyncio.wait_for(camera.measure(), WAIT_S)
    finally:
        await camera.close()
    assert begun_ns - 5_000_000_000 - 1_000_000 <= depth.t_robot_ns <= time.monotonic_ns() - 5_000_000_000


async def test_one_that_looks_up_is_told_as_it_sits(oak: type[Oak]) -> None:
    camera = OakD((0.2, 0.0, 0.05), np.radians(30.0))
    await camera.close()
    ahead = transform(camera.calibration.T_body_depth_matrix, np.array([[0.0, 0.0, 1.0]]))[0]
    np.testing.assert_allclose(ahead, [0.2 + np.cos(np.radians(30)), 0.0, 0.05 + 0.5], atol=1e-12)
    right, down = camera.calibration.T_body_depth_matrix[:3, :2].T
    assert right[1] == -1.0 and down[2] < -0.8


async def test_one_that_is_pulled_out_is_lost_and_comes_back(oak: type[Oak], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oak_d, "REOPEN_S", 0.02)
    camera = OakD(*AHEAD)
    try:
        oak.present = False
        with pytest.raises(DeviceLost, match=r"failed|cannot be opened"):
            await asyncio.wait_for(_measure_on(camera), WAIT_S)
        oak.present = True
        until_s = time.monotonic() + WAIT_S
        while oak.opened < 2:
            assert time.monotonic() < until_s
            await asyncio.sleep(0.01)
        while True:
            try:
                await asyncio.wait_for(camera.measure(), WAIT_S)
                break
            except DeviceLost:
                await asyncio.sleep(0.01)
    finally:
        await camera.close()


async def _measure_on(camera: OakD) -> None:
    while True:
        await camera.measure()


def test_no_camera_is_a_sentence(oak: type[Oak]) -> None:
    oak.present = False
    with pytest.raises(DeviceUnavailable, match=r"OAK-D cannot be opened.*USB 3"):
        OakD(*AHEAD)


def test_no_package_is_a_sentence_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "depthai", None)
    with pytest.raises(DeviceUnavailable, match=r"needs depthai, which is not installed; run: .*\[oak\]"):
        OakD(*AHEAD)


async def test_the_robot_opens_it_where_its_settings_say_so(oak: type[Oak]) -> None:
    devices = adapter.open_pi(PiConfig(depth="oak-d", depth_position_m=(0.1, 0.0, 0.0), **NOTHING_ELSE))
    try:
        sensor = devices.calibration.depth_sensor
        assert sensor is not None and sensor.T_body_depth[3] == 0.1
        assert devices.depth is not None
        await asyncio.wait_for(devices.depth.measure(), WAIT_S)
    finally:
        await devices.close()


def test_a_part_that_is_missing_closes_the_camera(oak: type[Oak]) -> None:
    """Else it is in use when robot-server starts again."""
    with pytest.raises(DeviceUnavailable, match="serial port"):
        adapter.open_pi(PiConfig(camera=False, depth="oak-d", serial_port="/dev/none"))
    assert not [t for t in threading.enumerate() if t.name == "oak-d"]
