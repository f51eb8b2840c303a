"""Where a robot on wheels has got to while nothing was tracked: dead reckoning with the filter's bias."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from shared.geometry import FloatArray
from station.motion.dead_reckoning import advance_on_floor
from station.motion.preintegration import ImuSegment
from station.slam.ukf.start.starter import Anchor

REMEMBERED = 400  # frames: a start in motion begins a window of a few seconds ago


class Coasting:
    """Carries the place where the next segment begins."""

    def __init__(self, anchor: Anchor, t_imu_ns: int) -> None:
        self._now = anchor
        self._past: deque[tuple[int, Anchor]] = deque([(t_imu_ns, anchor)], maxlen=REMEMBERED)

    @property
    def bias_gyro(self) -> FloatArray | None:
        """(3,) rad/s, as last estimated."""
        return None if self._now.bias is None else self._now.bias[:3]

    def advance(self, segment: ImuSegment, t_imu_ns: int, rolled_m: float | None) -> None:
        """Go on by IMU and wheels from the last frame on; stay in place where nothing is known of wheels (None)."""
        if rolled_m is not None:
            bias = 0.0 if self._now.bias is None else float(self._now.bias[2])
            turn = float(((segment.gyro[:, 2] - bias) * segment.dt_s).sum())
            x_world, yaw_rad = advance_on_floor(self._now.x_world, self._now.yaw_rad, turn, rolled_m)
            self._now = replace(self._now, x_world=x_world, yaw_rad=yaw_rad)
        self._past.append((t_imu_ns, self._now))

    def at(self, t_imu_ns: int) -> Anchor:
        """Where the robot was at a frame's time, or as near to it as is remembered."""
        return min(reversed(self._past), key=lambda item: abs(item[0] - t_imu_ns))[1]
