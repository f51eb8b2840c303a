"""Poses between known instants: of the body while it drives, or of a recorded path."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

import numpy as np

from robot.simulation.body import MotionState
from shared.geometry import FloatArray, se3, slerp


class MotionHistory:
    """The last seconds of motion; poses in between by cubic Hermite (position) and rotation vector (attitude)."""

    def __init__(self, keep_s: float = 2.0, rate_hz: float = 225.0) -> None:
        self._states: deque[MotionState] = deque(maxlen=int(keep_s * rate_hz))
        self._rate_hz = rate_hz

    def append(self, state: MotionState) -> None:
        self._states.append(state)

    @property
    def latest_s(self) -> float:
        return self._states[-1].t_s if self._states else -np.inf

    def pair(self, t_s: float) -> tuple[MotionState, MotionState]:
        """The states around an instant, the end ones outside the history."""
        states = self._states
        i = int((t_s - states[0].t_s) * self._rate_hz)
        i = min(max(i, 0), len(states) - 2)
        while i > 0 and states[i].t_s > t_s:
            i -= 1
        while i < len(states) - 2 and states[i + 1].t_s <= t_s:
            i += 1
        return states[i], states[i + 1]

    def between(self, low_s: float, high_s: float) -> list[MotionState]:
        """The states around a span, one beyond each end where known."""
        step_s = 1.0 / self._rate_hz
        return [s for s in self._states if low_s - step_s <= s.t_s <= high_s + step_s]

    def pose(self, t_s: float) -> FloatArray:
        """T_world_body (4, 4) at an instant; beyond the ends the end pose."""
        if len(self._states) == 1:
            only = self._states[0]
            return se3(only.R_world_body, only.p_world)
        a, b = self.pair(t_s)
        return interpolate(a, b, t_s)

    def carried(self, t_s: float) -> float:
        """How much a hand covers the lens, 0..1."""
        return self.pair(t_s)[0].carried if len(self._states) > 1 else 0.0


def interpolate(a: MotionState, b: MotionState, t_s: float) -> FloatArray:
    """T_world_body (4, 4) between two states."""
    h = b.t_s - a.t_s
    f = min(max((t_s - a.t_s) / h, 0.0), 1.0)
    f2, f3 = f * f, f * f * f
    p = (
        (2 * f3 - 3 * f2 + 1) * a.p_world
        + (f3 - 2 * f2 + f) * h * a.v_world
        + (3 * f2 - 2 * f3) * b.p_world
        + (f3 - f2) * h * b.v_world
    )
    R = slerp(a.R_world_body, b.R_world_body, f)
    return se3(R, p)


class RecordedPath:
    """A list of states as a smooth function of time."""

    def __init__(self, states: list[MotionState]) -> None:
        self.states = states
        self._times = [s.t_s for s in states]

    @property
    def start_s(self) -> float:
        return self._times[0]

    @property
    def end_s(self) -> float:
        return self._times[-1]

    def pose(self, t_s: float) -> FloatArray:
        """T_world_body (4, 4); beyond the ends the end pose."""
        i = min(max(bisect_right(self._times, t_s) - 1, 0), len(self._times) - 2)
        return interpolate(self.states[i], self.states[i + 1], t_s)
