"""Two hobby servos that carry the simulated camera: late, off by an error of each angle, with backlash and jitter."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from robot.simulation.body import TICK_S
from robot.simulation.config import ServoImperfections
from shared.geometry import FloatArray

ERROR_RANGE_RAD = math.radians(60)  # over which `error_deg` is meant
WAVES_PER_RAD = (1.0, 2.3, 4.1)  # of the error over the angle: a gain, a bend, and what teeth and potentiometer do
JITTER_S = 0.2  # over which the jitter changes
STILL_RAD = math.radians(0.01)


class Servos:
    """Pan and tilt; step() advances by one tick of the body. Heads that are never turned stay where they are."""

    def __init__(self, imperfections: ServoImperfections, seed: int) -> None:
        """`seed`: of the drive."""
        self._imperfections = imperfections
        self._rng = np.random.default_rng([seed, 16])
        own = self._rng if imperfections.seed is None else np.random.default_rng([imperfections.seed, 16])
        self._errors = [error_of_angle(math.radians(imperfections.error_deg), own) for _ in range(2)]
        self._told = (0.0, 0.0)
        self._waiting: deque[tuple[float, float]] = deque(
            [(0.0, 0.0)] * round(imperfections.delay_s / TICK_S), maxlen=round(imperfections.delay_s / TICK_S) + 1
        )
        self._gear = np.zeros(2)  # before backlash
        self._reached = np.zeros(2)  # behind it
        self._jitter = np.zeros(2)
        self._is_used = False

    def point(self, pan_rad: float, tilt_rad: float) -> None:
        """What they are told from now on."""
        self._told = (pan_rad, tilt_rad)

    def step(self) -> tuple[float, float]:
        """Pan and tilt (rad) of the camera one tick later."""
        self._waiting.append(self._told)
        told = self._waiting[0]
        self._is_used = self._is_used or any(told)
        if not self._is_used:
            return (0.0, 0.0)
        i = self._imperfections
        wanted = np.array([angle + error(angle) for angle, error in zip(told, self._errors, strict=True)])
        self._gear = self._gear + (wanted - self._gear) * -math.expm1(-TICK_S / i.lag_s) if i.lag_s else wanted
        play = math.radians(i.backlash_deg) / 2
        self._reached = np.clip(self._reached, self._gear - play, self._gear + play)
        stay = math.exp(-TICK_S / JITTER_S)
        kick = math.radians(i.jitter_deg) * math.sqrt(1 - stay**2)
        self._jitter = stay * self._jitter + kick * self._rng.standard_normal(2)
        pan, tilt = (self._reached + self._jitter).tolist()
        return pan, tilt


def error_of_angle(rms_rad: float, rng: np.random.Generator) -> Callable[[float], float]:
    """A smooth error of the angle, none at 0, of this root mean square within ERROR_RANGE_RAD."""
    size, phase = rng.standard_normal(len(WAVES_PER_RAD)), rng.uniform(0, 2 * np.pi, len(WAVES_PER_RAD))
    waves = np.array(WAVES_PER_RAD)

    def raw(angle: FloatArray) -> FloatArray:
        bend = np.sin(waves * angle[:, None] + phase) - np.sin(phase)
        return np.asarray(bend @ (size / waves))

    scale = rms_rad / math.sqrt(float((raw(np.linspace(-ERROR_RANGE_RAD, ERROR_RANGE_RAD, 121)) ** 2).mean()))
    return lambda angle: scale * float(raw(np.array([angle]))[0])
