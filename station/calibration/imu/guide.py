"""What a person who leaves an inertial unit alone is told meanwhile: for how long it has lain still."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.calibration.guidance import Guidance
from station.calibration.imu.calibrate import ADVISED_S, MIN_REST_S
from station.calibration.imu.still import NOISIEST, QUIET_SHARE, RESTLESS, WINDOW_S
from station.model.frames import ImuBatch

TIME = "time"
# The estimate's windows begin elsewhere than the guide's: at either end of a rest it may see one less.
ENOUGH_S = MIN_REST_S + 2 * WINDOW_S
SETTLING = 10  # windows, from which on a restless one is told from quiet ones


class StillGuide:
    """Follows windows of a second each, as the estimate does afterwards with all of them."""

    def __init__(self) -> None:
        self._scatter: list[FloatArray] = []  # (6,) standard deviations within each window
        self._rest_s = self._longest_s = 0.0

    def feel(self, imu: ImuBatch) -> Guidance:
        """Take in what came in about a second."""
        seconds = float(imu.t_robot_ns[-1] - imu.t_robot_ns[0]) * 1e-9
        scatter = np.hstack([imu.gyro_imu, imu.accel_imu]).std(axis=0)
        self._scatter.append(scatter)
        if self._is_restless(scatter):
            self._rest_s = 0.0
            return self._guidance("something moved it: lay it on a heavy table or the floor, motors off, hands off")
        self._rest_s += seconds
        self._longest_s = max(self._longest_s, self._rest_s)
        return self._guidance(self._wish())

    def _is_restless(self, scatter: FloatArray) -> bool:
        if (scatter > NOISIEST).any():
            return True
        quiet = np.quantile(self._scatter, QUIET_SHARE, axis=0)
        return len(self._scatter) >= SETTLING and bool((scatter > RESTLESS * quiet).any())

    def _wish(self) -> str:
        if self._rest_s >= ADVISED_S:
            return "enough: finish, or lay it on its other sides, ten seconds each, for the accelerometer"
        at_rest = f"leave it alone: {self._rest_s / 60:.0f} min {self._rest_s % 60:02.0f} s at rest"
        if self._longest_s < ENOUGH_S:
            return f"{at_rest} of at least {MIN_REST_S / 60:.0f} min"
        return f"{at_rest}; white noise is known, {ADVISED_S / 60:.0f} min tell the random walk"

    def _guidance(self, instruction: str) -> Guidance:
        share = min(1.0, self._longest_s / ADVISED_S)
        return Guidance(instruction, False, 0, (), {TIME: share}, self._longest_s >= ENOUGH_S, share >= 1.0)
