"""Exposure within limits: the camera's own automatics trade blur for noise, SLAM wants it the other way. Pure."""

from __future__ import annotations

from dataclasses import dataclass

TARGET = 110.0  # mean of 0..255
TOLERANCE = 0.15  # a change of brightness between keyframes costs matches: leave well enough alone
LARGEST_STEP = 2.0
MIN_EXPOSURE_US = 100
BLACK = 6.0  # sensor black level and noise at full gain stay below


@dataclass(frozen=True, slots=True)
class Exposure:
    time_us: int
    gain: float


class ExposureControl:
    """Exposure time first, up to its limit; then gain, up to its own."""

    def __init__(self, max_exposure_us: int, max_gain: float) -> None:
        self._max_exposure_us = max_exposure_us
        self._max_gain = max_gain

    def next(self, now: Exposure, brightness: float) -> Exposure | None:
        """The exposure to try after one that gave a mean brightness of 0..255; None to keep it."""
        ratio = TARGET / max(brightness, 1.0)
        if abs(ratio - 1.0) <= TOLERANCE:
            return None
        wanted = now.time_us * now.gain * min(LARGEST_STEP, max(1 / LARGEST_STEP, ratio))
        if wanted <= self._max_exposure_us:
            exposure = Exposure(max(MIN_EXPOSURE_US, round(wanted)), 1.0)
        else:
            exposure = Exposure(self._max_exposure_us, min(self._max_gain, wanted / self._max_exposure_us))
        return None if exposure == now else exposure

    def is_black(self, now: Exposure, brightness: float) -> bool:
        """Nothing to see although everything is open: lens cap or a dark room."""
        is_open = now.time_us >= 0.95 * self._max_exposure_us and now.gain >= 0.95 * self._max_gain
        return is_open and brightness < BLACK
