"""One continuous odometry from two: dead reckoning, always there, and SLAM, which knows better but answers later.

SLAM's pose of a frame comes when the frame was computed: a tenth of a second later, or seconds where the machine is
too slow. Waiting for it would leave the robot without odometry, changing over and back would tear the path. So SLAM's
motion replaces the reckoned one up to its last pose, and from there on the path is reckoned.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, inverse

REMEMBERED = 600  # reckoned poses: 30 s at 20 a second


@dataclass(frozen=True, slots=True, eq=False)
class _SlamPose:
    t_robot_ns: int
    T_world_body: FloatArray
    segment: int


class BlendedOdometry:
    """`T_nav_body` poses in one frame that starts where the first source does; metres."""

    def __init__(self) -> None:
        self._reckoned: deque[tuple[int, FloatArray]] = deque(maxlen=REMEMBERED)
        self._slam: _SlamPose | None = None
        self._anchor_t_ns = 0  # the blended path is known at this time,
        self._anchor = np.eye(4)  # ... and this is its pose there,
        self._reckoned_anchor: tuple[int, FloatArray] = (0, np.eye(4))  # ... and the reckoned one nearest to that time
        self.segment = 0  # counts the breaks: SLAM began anew and nothing reckoned what lay between

    def add_reckoned(self, t_robot_ns: int, T_nav_body: FloatArray) -> FloatArray:
        """A pose (4, 4) of dead reckoning, in its own frame; the blended pose at its time."""
        if not self._reckoned and self._slam is None:
            self._anchor_t_ns, self._anchor = t_robot_ns, T_nav_body
        is_nearer = abs(t_robot_ns - self._anchor_t_ns) < abs(self._reckoned_anchor[0] - self._anchor_t_ns)
        if not self._reckoned or is_nearer:
            self._reckoned_anchor = (t_robot_ns, T_nav_body)
        self._reckoned.append((t_robot_ns, T_nav_body))
        return self.at(t_robot_ns)

    def add_slam(self, t_robot_ns: int, T_world_body: FloatArray, segment: int) -> FloatArray:
        """A pose (4, 4) of SLAM, in its own frame; the blended pose at its time."""
        before = self._slam
        self._slam = _SlamPose(t_robot_ns, T_world_body, segment)
        if before is not None and before.segment == segment:
            self._anchor = self._anchor @ inverse(before.T_world_body) @ T_world_body
        elif self._reckoned:
            self._anchor = self.at(t_robot_ns)
        else:
            self.segment += before is not None
            self._anchor = T_world_body
        self._anchor_t_ns = t_robot_ns
        if self._reckoned:
            self._reckoned_anchor = self._reckoned_at(t_robot_ns)
        return self._anchor

    def at(self, t_robot_ns: int) -> FloatArray:
        """The blended pose (4, 4) at a time, as far as is known now."""
        if not self._reckoned:
            return self._anchor
        # The anchor's own is kept: without SLAM for long, it is older than all that is remembered.
        return self._anchor @ inverse(self._reckoned_anchor[1]) @ self._reckoned_at(t_robot_ns)[1]

    def _reckoned_at(self, t_robot_ns: int) -> tuple[int, FloatArray]:
        """The reckoned pose that is nearest in time, with its time; the newest ones are asked for most."""
        best = self._reckoned[-1]
        for pose in reversed(self._reckoned):
            if abs(pose[0] - t_robot_ns) > abs(best[0] - t_robot_ns):
                break
            best = pose
        return best
