"""What a person who carries the robot about is told next: which turn is missing, and for how long."""

from __future__ import annotations

import numpy as np

from station.calibration.guidance import Guidance
from station.calibration.targetless.tracks import MAX_USED_S
from station.model.frames import ImuBatch

WANTED_TURN_RAD = 6.0  # about each axis, to and fro, as before a board
LEAST_TIME = 0.5  # of the time wanted; less hardly ever suffices
SLOW_RAD_S = 0.15  # slower is drift of the gyroscope, or nearly
TIME = "time"
WISHES = {  # about the body's axes: forward, left, up
    "roll": "roll the robot, as one turns a steering wheel",
    "tilt": "tilt it up and down, briskly",
    "turn": "turn it left and right, briskly",
}


class LivelyGuide:
    """Follows by the gyroscope alone how the robot is turned."""

    def __init__(self) -> None:
        self._turned = np.zeros(3)  # rad about the body's axes
        self._seconds = 0.0

    def feel(self, imu: ImuBatch) -> Guidance:
        """Take in what came in about a second."""
        seconds = np.diff(imu.t_robot_ns, prepend=imu.t_robot_ns[0]) * 1e-9
        rate = np.linalg.norm(imu.gyro_imu, axis=1)
        is_lively = rate > SLOW_RAD_S
        self._turned += np.abs(imu.gyro_imu[is_lively] * seconds[is_lively, None]).sum(axis=0)
        self._seconds += float(seconds[is_lively].sum())
        shares = self._shares()
        may_finish, is_enough = shares[TIME] >= LEAST_TIME, min(shares.values()) >= 1.0
        return Guidance(self._wish(), False, 0, (), shares, may_finish, is_enough)

    def _shares(self) -> dict[str, float]:
        shares = [*(self._turned / WANTED_TURN_RAD), self._seconds / MAX_USED_S]
        return {name: min(1.0, float(share)) for name, share in zip((*WISHES, TIME), shares, strict=True)}

    def _wish(self) -> str:
        shares = self._shares()
        missing = min(WISHES, key=lambda name: shares[name])
        if shares[missing] < 1.0:
            return f"{WISHES[missing]}, and carry it about, past things the camera can follow"
        if shares[TIME] < 1.0:
            return f"go on for {MAX_USED_S - self._seconds:.0f} s"
        return "enough: finish"
