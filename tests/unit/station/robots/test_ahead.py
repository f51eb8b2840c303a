"""How far the next thing ahead is, of what a depth sensor measured."""

from __future__ import annotations

import asyncio

import msgspec
import numpy as np
import pytest

from robot.devices.pi.hc_sr04 import calibration_of
from shared.calibration import REFERENCE_ROBOT, DepthCalibration
from shared.geometry import se3
from shared.messages import Depth, Hello
from station.events import EventKind
from station.model.frames import DepthArray, DepthFrame
from station.robots.ahead import FORGOTTEN_NS, AheadWatch, distance_ahead
from tests.support.depth import FORWARD, depth_camera, encoded
from tests.support.recordings import HELLO

CAMERA = depth_camera(160, 120)  # looks along x, 0.1 m before the IMU and 5 cm to its left
SONAR = calibration_of((0.2, 0.0, -0.1))


def view(sensor: DepthCalibration, floor_m: float = 0.2, wall_m: float = 3.0) -> DepthArray:
    """(H, W) mm of a floor so deep below the sensor, up to a wall so far ahead."""
    v, _ = np.mgrid[0 : sensor.height, 0 : sensor.width].astype(float)
    down = (v - sensor.cy) / sensor.fy
    z = np.minimum(np.where(down > 0, floor_m / np.maximum(down, 1e-9), np.inf), wall_m)
    return np.round(1000 * z).astype(np.uint16)


def put(picture: DepthArray, sensor: DepthCalibration, at_m: tuple[float, float, float], half_m: float) -> DepthArray:
    """With a plate across the way: ahead, left of the sensor, up from it, m; so far to each side."""
    ahead, left, up = at_m
    v, u = np.mgrid[0 : sensor.height, 0 : sensor.width].astype(float)
    x, y = (u - sensor.cx) / sensor.fx * ahead, (v - sensor.cy) / sensor.fy * ahead
    on = (np.abs(-x - left) < half_m) & (np.abs(-y - up) < half_m)
    return np.where(on, np.minimum(picture, round(1000 * ahead)), picture).astype(np.uint16)


def ahead(picture: DepthArray, sensor: DepthCalibration = CAMERA) -> float | None:
    return distance_ahead(DepthFrame(5, encoded(picture), sensor))


@pytest.mark.parametrize(("millimetres", "metres"), [(820, 0.82), (0, None), (65535, None)])
def test_of_a_range_sensor_it_is_what_it_hears(millimetres: int, metres: float | None) -> None:
    assert ahead(np.array([[millimetres]], dtype=np.uint16), SONAR) == metres


def test_of_a_picture_it_is_the_wall_and_not_the_floor_before_it() -> None:
    picture = view(CAMERA)
    assert picture.min() < 600  # the floor is nearer
    assert ahead(picture) == pytest.approx(3.0)


def test_something_in_the_way_counts_and_something_beside_below_or_above_it_does_not() -> None:
    assert ahead(put(view(CAMERA), CAMERA, (1.2, 0.0, 0.0), 0.05)) == pytest.approx(1.2)
    assert ahead(put(view(CAMERA), CAMERA, (1.2, 0.15, 0.0), 0.02)) == pytest.approx(1.2)  # 20 cm left of the middle
    for beside in ((1.2, 0.35, 0.0), (1.2, -0.45, 0.0), (1.2, 0.0, 0.3), (1.2, 0.0, -0.18)):
        assert ahead(put(view(CAMERA), CAMERA, beside, 0.05)) == pytest.approx(3.0), beside


def test_a_sensor_that_looks_down_measures_forward() -> None:
    pitch = np.radians(20.0)
    R = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]) @ FORWARD
    tilted = msgspec.structs.replace(CAMERA, T_body_depth=tuple(se3(R, np.array([0.1, 0.0, 0.3])).ravel().tolist()))
    v, u = np.mgrid[0:120, 0:160].astype(float)
    rays = np.stack([(u - tilted.cx) / tilted.fx, (v - tilted.cy) / tilted.fy, np.ones(u.shape)], axis=-1) @ R.T
    wall = np.round(1000 * 1.5 / rays[..., 0]).astype(np.uint16)  # 1.5 m before the sensor, upright
    assert ahead(wall, tilted) == pytest.approx(1.5, abs=0.002)


def test_single_false_pixels_are_passed_over_and_zones_are_not() -> None:
    picture = view(CAMERA)
    picture[60, 70:79] = 400  # nine of 19,200
    assert ahead(picture) == pytest.approx(3.0)
    zones = msgspec.structs.replace(CAMERA, width=8, height=8, fx=9.66, fy=9.66, cx=3.5, cy=3.5)
    few = np.full((8, 8), 3000, dtype=np.uint16)
    few[3, 3] = 500
    assert ahead(few, zones) == pytest.approx(0.5)


def test_where_nothing_was_measured_nobody_says_that_the_way_is_free() -> None:
    assert ahead(np.zeros((120, 160), dtype=np.uint16)) is None


class Notes:
    def __init__(self) -> None:
        self.kinds: list[EventKind] = []

    def changed(self, kind: EventKind, subject: object = None, key: str = "") -> None:
        self.kinds.append(kind)

    def forget(self, kind: EventKind, key: str) -> None: ...

    def notify(self, topic: str, text: str, level: str = "info") -> None: ...


def told(sensor: DepthCalibration | None) -> Hello:
    calibration = REFERENCE_ROBOT if sensor is None else msgspec.structs.replace(REFERENCE_ROBOT, depth=sensor)
    return msgspec.structs.replace(HELLO, calibration=calibration)


async def test_the_newest_is_kept_for_a_second_and_a_half_and_only_of_the_robot_that_is_there() -> None:
    now_ns, notes = [0], Notes()
    watch = AheadWatch(notes, lambda: now_ns[0])
    running = asyncio.create_task(watch.run())

    async def measure(png: bytes) -> None:
        before = len(notes.kinds)
        watch.on_depth(Depth(seq=0, t_robot_ns=5, png=png))
        async with asyncio.timeout(20.0):
            while len(notes.kinds) == before:
                await asyncio.sleep(0.002)

    try:
        watch.on_connected(told(None))
        assert not watch.has_sensor
        watch.on_depth(Depth(seq=0, t_robot_ns=5, png=encoded(np.array([[820]], np.uint16))))  # of no sensor
        watch.on_connected(told(SONAR))
        assert watch.has_sensor and watch.newest is None
        watch.on_depth(Depth(seq=0, t_robot_ns=5, png=b"damaged"))  # ends nothing
        await asyncio.sleep(0.05)
        await measure(encoded(np.array([[820]], np.uint16)))
        assert watch.newest is not None and watch.newest.distance_m == 0.82
        now_ns[0] += FORGOTTEN_NS
        assert watch.newest is not None
        now_ns[0] += 1
        assert watch.newest is None
        await measure(encoded(np.array([[0]], np.uint16)))
        assert watch.newest is not None and watch.newest.distance_m is None
        watch.on_disconnected("gone")
        assert watch.newest is None and not watch.has_sensor
    finally:
        running.cancel()
