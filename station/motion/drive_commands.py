"""What drive commands say of a robot on wheels: how far its wheels have rolled, and when the body stands still.

Only the forward speed is believed: of a commanded turn, wheels that skid achieve a third.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from shared.geometry import FloatArray, IntArray
from station.model.frames import DriveSample, ImuBatch

# Wheels follow a command like a first-order lag with this time constant. The simulated motors answer like two lags of
# 0.08 s, one after the other (BodyParameters.lag_s in robot/simulation/config.py): in the mean 0.16 s late. Fitted to
# the true speed of simulated drives, a single lag is best from 0.16 to 0.17 s.
MOTOR_LAG_S = 0.16
# Speed over ground by commanded speed, where nothing measures it: wheels slip a little (0.96 in the simulator).
SPEED_EFFICIENCY = 0.97
# While a robot is followed, a command counts this long at most: where none comes any more, the robot has stopped by
# itself. In a recorded navigation every command holds until the next one, since what the robot did is all there.
COMMAND_HOLD_S = 0.5
# From the end of motion in the commands to the body at rest: the motors' lag four times over.
REST_AFTER_S = 0.7
MIN_COMMAND = 1e-3  # m/s or rad/s; less moves nothing


def commands_motion(drive: DriveSample) -> bool:
    """Whether the wheels are to turn."""
    return abs(drive.linear_m_s) > MIN_COMMAND or abs(drive.angular_rad_s) > MIN_COMMAND


class WheelSpeed:
    """How fast the wheels roll the body forward, and how far they have: the commands through lag and slip."""

    def __init__(self, hold_s: float = COMMAND_HOLD_S, efficiency: float = SPEED_EFFICIENCY) -> None:
        self.speed_m_s = 0.0
        self.way_m = 0.0  # since the first time or command; backwards counts negative
        self._hold_ns = hold_s * 1e9
        self._efficiency = efficiency
        self._t_ns: float = -math.inf
        self._target = 0.0
        self._until_ns: float = -math.inf  # when the command ends by itself

    @property
    def missing_m_s(self) -> float:
        """What the wheels have still to make of the command's change: they lag behind it."""
        return self._target - self.speed_m_s

    def add_drive(self, drive: DriveSample) -> None:
        """A command, from its time on; from now on where it came late."""
        self.advance(drive.t_robot_ns)
        self._target = self._efficiency * drive.linear_m_s
        self._until_ns = drive.t_robot_ns + self._hold_ns

    def advance(self, t_ns: int) -> None:
        """Go on to a time. Nothing happens when it has passed."""
        if self._t_ns < self._until_ns:
            self._follow(min(t_ns, self._until_ns))
        if t_ns >= self._until_ns:
            self._target = 0.0
        self._follow(t_ns)

    def _follow(self, t_ns: float) -> None:
        """The first-order lag's closed form, to a time until which the command is the same."""
        if t_ns <= self._t_ns:
            return
        seconds = 0.0 if self._t_ns == -math.inf else (t_ns - self._t_ns) * 1e-9
        missing = self.speed_m_s - self._target
        left = missing * math.exp(-seconds / MOTOR_LAG_S)
        self.speed_m_s = self._target + left
        self.way_m += self._target * seconds + (missing - left) * MOTOR_LAG_S
        self._t_ns = t_ns


def wheel_motion(drive: list[DriveSample], t_ns: IntArray) -> tuple[FloatArray, FloatArray]:
    """Forward speed (M,) m/s and way (M,) m of a recorded navigation at increasing times, as if nothing slipped.

    Who has the whole navigation finds by itself how much of the commanded way was made: the scale is fused with the
    IMU's.
    """
    wheels = WheelSpeed(hold_s=math.inf, efficiency=1.0)
    speed, way = np.empty(len(t_ns)), np.empty(len(t_ns))
    coming = 0
    for i, t in enumerate(t_ns.tolist()):
        while coming < len(drive) and drive[coming].t_robot_ns <= t:
            wheels.add_drive(drive[coming])
            coming += 1
        wheels.advance(t)
        speed[i], way[i] = wheels.speed_m_s, wheels.way_m
    return speed, way


class CommandedRest:
    """Whether the body rests as far as the commands say. Hands may move it; only its sensors know of that."""

    def __init__(self) -> None:
        self._rest_from_ns = 0

    def add_drive(self, drive: DriveSample) -> None:
        until_rest_ns = round(REST_AFTER_S * 1e9)
        if commands_motion(drive):
            self._rest_from_ns = drive.t_robot_ns + round(COMMAND_HOLD_S * 1e9) + until_rest_ns
        else:
            self._rest_from_ns = min(self._rest_from_ns, drive.t_robot_ns + until_rest_ns)

    def is_resting(self, t_ns: int) -> bool:
        return t_ns > self._rest_from_ns


def resting_samples(imu: ImuBatch, drive: list[DriveSample]) -> npt.NDArray[np.bool_]:
    """(N,) samples of a recorded navigation during which the body rested, as far as the commands say."""
    begin = np.array([d.t_robot_ns for d in drive], dtype=np.int64)
    moves = np.flatnonzero(np.array([commands_motion(d) for d in drive], dtype=bool))
    if not len(moves):
        return np.ones(len(imu), dtype=bool)
    end = np.append(begin, np.iinfo(np.int64).max)[moves + 1]
    k = np.searchsorted(begin[moves], imu.t_robot_ns, side="right") - 1  # the last command to move before each sample
    return np.asarray((k < 0) | (imu.t_robot_ns - round(REST_AFTER_S * 1e9) >= end[np.maximum(k, 0)]))
