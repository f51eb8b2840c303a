"""Poses between known instants: of the body while it drives, or of a recorded path."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable

import numpy as np

from robot.simulation.body import TICK_RATE_HZ, TICK_S, MotionState
from shared.calibration import HeadCalibration
from shared.geometry import FloatArray, se3, slerp
from shared.head import turned


class MotionHistory:
    """Motion in order of time; poses in between by cubic Hermite (position) and rotation vector (attitude).

    Beyond its ends the end states hold.
    """

    def __init__(self, states: Iterable[MotionState] = (), keep_s: float | None = None) -> None:
        self.states = deque(states, maxlen=None if keep_s is None else int(keep_s * TICK_RATE_HZ))

    def append(self, state: MotionState) -> None:
        self.states.append(state)

    @property
    def start_s(self) -> float:
        return self.states[0].t_s

    @property
    def end_s(self) -> float:
        return self.states[-1].t_s if self.states else -np.inf

    def between(self, low_s: float, high_s: float) -> list[MotionState]:
        """The states around a span, one beyond each end where known."""
        return [s for s in self.states if low_s - TICK_S <= s.t_s <= high_s + TICK_S]

    def pose(self, t_s: float) -> FloatArray:
        """T_world_body (4, 4)."""
        a, b = self._around(t_s)
        return interpolate(a, b, t_s)

    def head_pose(self, t_s: float, head: HeadCalibration | None) -> FloatArray:
        """T_world_head (4, 4): the body's pose, turned as the camera's head is (shared/head.py)."""
        a, b = self._around(t_s)
        T_world_body = interpolate(a, b, t_s)
        if head is None or not any((*a.head, *b.head)):
            return T_world_body
        f = share_between(a, b, t_s)
        pan, tilt = ((1.0 - f) * x + f * y for x, y in zip(a.head, b.head, strict=True))
        return T_world_body @ turned(head, pan, tilt)

    def carried(self, t_s: float) -> float:
        """How much a hand covers the lens, 0..1."""
        return self._around(t_s)[0].carried

    def _around(self, t_s: float) -> tuple[MotionState, MotionState]:
        after = bisect_right(self.states, t_s, key=lambda state: state.t_s)
        i = min(max(after - 1, 0), max(len(self.states) - 2, 0))
        return self.states[i], self.states[min(i + 1, len(self.states) - 1)]


def interpolate(a: MotionState, b: MotionState, t_s: float) -> FloatArray:
    """T_world_body (4, 4) between two states, which may be one."""
    if a is b:
        return se3(a.R_world_body, a.p_world)
    h = b.t_s - a.t_s
    f = share_between(a, b, t_s)
    f2, f3 = f * f, f * f * f
    p = (
        (2 * f3 - 3 * f2 + 1) * a.p_world
        + (f3 - 2 * f2 + f) * h * a.v_world
        + (3 * f2 - 2 * f3) * b.p_world
        + (f3 - f2) * h * b.v_world
    )
    R = slerp(a.R_world_body, b.R_world_body, f)
    return se3(R, p)


def share_between(a: MotionState, b: MotionState, t_s: float) -> float:
    """How far from a to b a time lies, 0..1; 0 where they are one."""
    h = b.t_s - a.t_s
    return 0.0 if h <= 0.0 else min(max((t_s - a.t_s) / h, 0.0), 1.0)
