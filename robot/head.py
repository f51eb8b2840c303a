"""Leads the camera head to where it shall look, evenly: pictures stay sharp, and its angle is known all the way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from shared.calibration import HeadCalibration

STEP_S = 0.02  # hobby servos take a pulse every 20 ms


class CameraHead:
    """A pan-tilt head on its way. Time is an argument: any clock that runs evenly, ns."""

    def __init__(self, point: Callable[[float, float], None], calibration: HeadCalibration | None) -> None:
        """`point` is PanTilt's. Without a calibration nobody knows a speed that suits: the servos go there at once."""
        self._point = point
        self._calibration = calibration
        self._from = self._to = (0.0, 0.0)
        self._since_ns = 0
        self._led = (0.0, 0.0)  # what the servos were told last

    def look(self, pan: float, tilt: float, now_ns: int) -> None:
        """Turn to these angles (rad), as far as the head can. Raises HardwareError as the servos do."""
        head = self._calibration
        if head is not None:
            pan = min(max(pan, -head.max_pan), head.max_pan)
            tilt = min(max(tilt, -head.max_tilt), head.max_tilt)
        self._from, self._to, self._since_ns = self.told(now_ns), (pan, tilt), now_ns
        self.lead(now_ns)

    def told(self, now_ns: int) -> tuple[float, float]:
        """Pan and tilt (rad) that the servos are told at this time."""
        if self._calibration is None:
            return self._to
        reach = self._calibration.speed * max(0, now_ns - self._since_ns) * 1e-9
        pan, tilt = (
            a + float(np.clip(b - a, -reach, reach)) if abs(b - a) > reach else b
            for a, b in zip(self._from, self._to, strict=True)
        )
        return pan, tilt

    def turns(self, now_ns: int) -> bool:
        """Whether it is still on its way."""
        return self.told(now_ns) != self._to

    def lags(self, now_ns: int) -> bool:
        """Whether the servos were told other angles last: also when the whole way went by since."""
        return self.told(now_ns) != self._led

    def lead(self, now_ns: int) -> None:
        """Tell the servos their angles of this time. Raises HardwareError as they do."""
        angles = self.told(now_ns)
        self._point(*angles)
        self._led = angles
