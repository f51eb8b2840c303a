"""How far the next thing ahead is, as the robot's depth sensor measures it: for whoever drives. Nothing stops by it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shared.calibration import DepthCalibration
from shared.errors import DataError
from shared.geometry import FloatArray, transform
from shared.messages import Depth, Hello
from station.events import Latest, Notifier
from station.model.frames import DepthArray, DepthFrame
from station.robots.link_events import IgnoringListener

# What the robot would touch, going on: as wide as it is, and a hand more.
HALF_WIDTH_M = 0.25
# Of a picture, what is about as high as the sensor: how far below it the floor is, no calibration tells.
HALF_HEIGHT_M = 0.1
FALSE_SHARE = 1 / 2000  # of a picture's pixels may be nearer and yet nothing: single ones are wrong
FORGOTTEN_NS = 1_500_000_000  # a robot in motion is 60 cm further by then


@dataclass(frozen=True, slots=True)
class Ahead:
    """The newest measurement."""

    distance_m: float | None  # from the sensor; None: nothing was measured there, which is not to say that nothing is
    t_station_ns: int


class AheadWatch(IgnoringListener):
    """A LinkListener that measures what lies ahead. Pictures are taken apart in a thread: the newest wins."""

    def __init__(self, notifier: Notifier, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._notifier = notifier
        self._now_ns = now_ns
        self._sensor: DepthCalibration | None = None
        self._frames: Latest[DepthFrame] = Latest()
        self._newest: Ahead | None = None

    @property
    def has_sensor(self) -> bool:
        """Whether the robot that is connected has one."""
        return self._sensor is not None

    @property
    def newest(self) -> Ahead | None:
        """None where nothing has been measured lately."""
        newest = self._newest
        return newest if newest is not None and self._now_ns() - newest.t_station_ns <= FORGOTTEN_NS else None

    async def run(self) -> None:
        """Measure until cancelled."""
        while True:
            frame = await self._frames.get()
            t_station_ns = self._now_ns()
            try:
                distance_m = await asyncio.to_thread(distance_ahead, frame)
            except DataError:
                continue  # SLAM says so, where it matters
            if frame.sensor == self._sensor:
                self._newest = Ahead(distance_m, t_station_ns)
                self._notifier.changed("robot")

    def on_connected(self, hello: Hello) -> None:
        self.on_calibration(hello)

    def on_calibration(self, hello: Hello) -> None:
        self._sensor, self._newest = hello.calibration.depth_sensor, None

    def on_disconnected(self, reason: str) -> None:  # noqa: ARG002
        self._sensor = self._newest = None

    def on_depth(self, depth: Depth) -> None:
        if self._sensor is not None:
            self._frames.put(DepthFrame(depth.t_robot_ns, depth.png, self._sensor))


def distance_ahead(frame: DepthFrame) -> float | None:
    """How far from the sensor the next thing is that it sees before the robot, m. Raises DataError."""
    millimetres = frame.millimetres()
    forward = millimetres[millimetres > 0] / 1000.0 if frame.sensor.is_cone else _in_the_way(millimetres, frame.sensor)
    if not len(forward):
        return None
    passed_over = min(int(FALSE_SHARE * millimetres.size), len(forward) - 1)
    return float(np.partition(forward, passed_over)[passed_over])


def _in_the_way(millimetres: DepthArray, sensor: DepthCalibration) -> FloatArray:
    """(n,) m forward from the sensor, of its pixels that see something before the robot."""
    v, u = np.nonzero(millimetres)
    z = millimetres[v, u] / 1000.0
    T_body_depth = sensor.T_body_depth_matrix
    points = np.column_stack([(u - sensor.cx) / sensor.fx * z, (v - sensor.cy) / sensor.fy * z, z])
    x, y, z_up = transform(T_body_depth, points).T
    forward = x - T_body_depth[0, 3]
    is_before = (np.abs(y) < HALF_WIDTH_M) & (np.abs(z_up - T_body_depth[2, 3]) < HALF_HEIGHT_M) & (forward > 0)
    return np.asarray(forward[is_before])
