"""Follows a route by pure pursuit on the true pose: what a person with a joystick would do, every time the same."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot.head import CameraHead
from robot.simulation.routes import Route
from robot.watchdog import STANDSTILL, Velocity

LOOKAHEAD_M = 0.28
WINDOW_POINTS = 40  # the nearest point is sought this far ahead only, so that a crossing route stays in order
GOAL_M = 0.12
MAX_COMMAND_RAD_S = 2.4  # robot-server refuses more than 2.5
STUCK_M, STUCK_COMMANDS = 0.05, 18  # a bit more than a second without getting on
BACKING_COMMANDS = 12
PIVOT_RAD = 1.2  # turn in place first when the route points further aside than this


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast somebody drives."""

    max_speed_m_s: float
    max_yaw_rate_rad_s: float  # that is meant


CALM = Pace(0.42, 0.5)
BRISK = Pace(0.5, 0.8)  # as SLAM still follows (docs/studies/demo.md)
PACES = {"calm": CALM, "brisk": BRISK}


class LookAround:
    """Turns the head from side to side: what a person at the page would do who wants to see everything."""

    def __init__(self, reach_rad: float, rest_s: float = 1.0) -> None:
        """`rest_s`: how long it looks to each side."""
        self._reach, self._rest_ns = reach_rad, round(rest_s * 1e9)
        self._moved_ns: int | None = None  # when it was last seen on its way

    def turn(self, head: CameraHead, now_ns: int) -> None:
        """Look to the other side where the head has rested long enough. Called several times a second."""
        if self._moved_ns is None or head.turns(now_ns):
            is_first, self._moved_ns = self._moved_ns is None, now_ns
            if not is_first:
                return
        elif now_ns - self._moved_ns < self._rest_ns:
            return
        self._moved_ns, self._reach = now_ns, -self._reach
        head.look(-self._reach, 0.0, now_ns)


class RouteDriver:
    """Gives a command for each true pose until the route ends."""

    def __init__(self, route: Route, expected_yaw_efficiency: float = 0.33, pace: Pace = CALM) -> None:
        self._route, self._pace = route, pace
        self._index = 0
        self._efficiency = expected_yaw_efficiency
        self._last_yaw_rate = self._last_linear = 0.0
        self._anchor, self._idle, self._backing = (math.inf, math.inf), 0, 0
        self.is_done = False

    @property
    def progress(self) -> float:
        """Share of the route driven, 0..1."""
        return 1.0 if self.is_done else self._index / max(1, len(self._route.points) - 1)

    def _is_stuck(self, x_m: float, y_m: float) -> bool:
        """Whether the robot has been told to go but did not; then it backs off for a moment."""
        if self._backing > 0:
            self._backing -= 1
            return True
        if math.hypot(x_m - self._anchor[0], y_m - self._anchor[1]) > STUCK_M or self._last_linear < 0.06:
            self._anchor, self._idle = (x_m, y_m), 0
        self._idle += 1
        if self._idle > STUCK_COMMANDS:
            self._idle, self._backing = 0, BACKING_COMMANDS
        return False

    def command(self, x_m: float, y_m: float, yaw_rad: float, yaw_rate_rad_s: float) -> Velocity:
        """The command for the present pose and achieved yaw rate."""
        points = self._route.points
        window = points[self._index : self._index + WINDOW_POINTS]
        distance = np.hypot(window[:, 0] - x_m, window[:, 1] - y_m)
        self._index += int(np.argmin(distance))
        if self._index >= len(points) - 3 and math.hypot(*(points[-1] - (x_m, y_m))) < GOAL_M + 0.05:
            self.is_done = True
        if self.is_done or self._index >= len(points) - 1:
            self.is_done = True
            return STANDSTILL
        target = points[min(self._index + int(LOOKAHEAD_M / 0.05), len(points) - 1)]
        bearing = math.atan2(target[1] - y_m, target[0] - x_m) - yaw_rad
        bearing = (bearing + math.pi) % (2 * math.pi) - math.pi
        reach = max(0.1, math.hypot(target[0] - x_m, target[1] - y_m))
        if abs(bearing) > PIVOT_RAD:
            linear, yaw_rate = 0.05, math.copysign(self._pace.max_yaw_rate_rad_s, bearing)
        else:
            curvature = 2 * math.sin(bearing) / reach
            linear = min(self._pace.max_speed_m_s, self._pace.max_yaw_rate_rad_s / max(abs(curvature), 1e-6))
            yaw_rate = linear * curvature
        if self._is_stuck(x_m, y_m):
            linear = -0.15
        self._last_linear = linear
        self._learn_efficiency(yaw_rate_rad_s)
        self._last_yaw_rate = float(np.clip(yaw_rate / self._efficiency, -MAX_COMMAND_RAD_S, MAX_COMMAND_RAD_S))
        return Velocity(linear, self._last_yaw_rate)

    def _learn_efficiency(self, yaw_rate_rad_s: float) -> None:
        """How much of the commanded turning the wheels achieve here, as a driver feels after a second."""
        if abs(self._last_yaw_rate) > 0.5:
            ratio = yaw_rate_rad_s / self._last_yaw_rate
            self._efficiency = float(np.clip(self._efficiency + 0.03 * (ratio - self._efficiency), 0.15, 1.2))
