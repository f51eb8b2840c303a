"""The HC-SR04 behind the depth port: what a measurement of the Mega becomes."""

from __future__ import annotations

import asyncio
from typing import cast

import numpy as np
import pytest

from robot.config import PiConfig
from robot.devices.pi import adapter
from robot.devices.pi.hc_sr04 import HcSr04, calibration_of
from robot.devices.pi.mega import Mega, RangeReading
from robot.devices.pi.mega_clock import MegaClock
from robot.devices.ports import CapturedDepth
from shared import serial_protocol as sp
from shared.calibration import REFERENCE_ROBOT
from shared.errors import DeviceLost
from shared.geometry import transform
from station.model.frames import DepthFrame
from tests.support.mega_lines import FakeLine, imu, opened

SENSOR = calibration_of((0.2, 0.0, -0.1))


class OneReading:
    """A Mega of which one measurement is known."""

    def __init__(self, echo: int, echo_us: int) -> None:
        self.reading = RangeReading(5_000_000, echo, echo_us)

    async def wait_range(self) -> RangeReading:
        return self.reading


def measured(echo: int, echo_us: int) -> CapturedDepth:
    return asyncio.run(HcSr04(cast(Mega, OneReading(echo, echo_us))).measure())


@pytest.mark.parametrize(("echo_us", "millimetres"), [(117, 20), (5831, 1000), (23324, 4000), (1, 1)])
def test_an_echo_is_half_its_way_in_millimetres(echo_us: int, millimetres: int) -> None:
    depth = measured(sp.Echo.HEARD, echo_us)
    picture = DepthFrame(depth.t_robot_ns, depth.png, SENSOR).millimetres()
    assert depth.t_robot_ns == 5_000_000 and picture.tolist() == [[millimetres]]


def test_no_echo_is_nothing_measured_and_no_fault() -> None:
    depth = measured(sp.Echo.NONE, 0)
    assert DepthFrame(depth.t_robot_ns, depth.png, SENSOR).millimetres().tolist() == [[0]]


@pytest.mark.parametrize("echo", [sp.Echo.SILENT, 77])
def test_a_silent_sensor_is_lost_with_its_wires_named(echo: int) -> None:
    with pytest.raises(DeviceLost, match="TRIG 49, ECHO 48"):
        measured(echo, 0)


def test_its_one_pixel_is_as_wide_as_its_cone_and_looks_ahead() -> None:
    assert SENSOR.is_cone and (SENSOR.width, SENSOR.height) == (1, 1)
    edge = np.array([[0.5 / SENSOR.fx, 0.0, 1.0]])
    x, y, z = transform(SENSOR.T_body_depth_matrix, edge)[0] - [0.2, 0.0, -0.1]
    assert z == 0.0 and x == 1.0 and np.degrees(np.arctan2(-y, x)) == pytest.approx(15.0)


def test_the_newest_measurement_comes_with_the_time_when_the_sound_turned_round() -> None:
    line = FakeLine(1)
    with opened(line, now_ns=lambda: 7_000_000_000, range_sensor=sp.ConfigRange(100)) as mega:
        line.say(imu(0), imu(1))
        asyncio.run(mega.wait_readings())
        line.say(sp.RangePacket(0, 2000, 100, sp.Echo.HEARD), sp.RangePacket(1, 5444, 200, sp.Echo.HEARD), imu(2))
        while True:
            reading = asyncio.run(mega.wait_range())
            if reading.echo_us == 200:
                break
    # The sample before it has the same stamp.
    assert reading.t_robot_ns == pytest.approx(7_000_000_000 - 2_550_000, abs=200_000)


def test_a_time_between_samples_is_that_of_their_clock_and_moves_none_of_them() -> None:
    clock, other = MegaClock(), MegaClock()
    assert clock.at(100, 5) == 5  # nothing is known yet
    for k in range(100):
        t_us = (2**32 - 200_000 + 4444 * k) % 2**32  # past the wrap
        stamp = clock.stamp(t_us, 10**10 + 4_444_000 * k)
        assert stamp == other.stamp(t_us, 10**10 + 4_444_000 * k)
        assert clock.at((t_us - 2000) % 2**32, 0) == pytest.approx(stamp - 2_000_000, abs=2000)


def test_the_settings_put_it_into_the_calibration_that_stations_are_told() -> None:
    plain = adapter.load_calibration(PiConfig())
    assert plain.depth_sensor is None and not adapter.uses_mega(
        PiConfig(imu=False, motors="none", pan_tilt="none", battery="none")
    )
    config = PiConfig(depth="hc-sr04", depth_position_m=(0.2, 0.0, -0.1))
    assert adapter.load_calibration(config).depth_sensor == SENSOR
    assert adapter.load_calibration(config, REFERENCE_ROBOT).depth_sensor == SENSOR
    assert adapter.uses_mega(PiConfig(imu=False, motors="none", pan_tilt="none", battery="none", depth="hc-sr04"))
