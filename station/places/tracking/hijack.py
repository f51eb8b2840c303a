"""Hijack: the robot is picked up and put down elsewhere. Noticed by IMU, by vision, and by where images say it is.

- IMU: lifted (velocity along the vertical), tilted, or turned while the motors rest. A robot on a floor does none; what
  has no wheels does all of it all the time, and is only seen to be moved by vision and position.
- Vision: what was seen a moment ago is gone although the gyro says it did not turn, and the new view stays.
- Position: the estimate of the current place goes over to where the robot cannot have driven (`current.py`).
Pure: times come with the data. docs/localisation.md has the thresholds' origin and false alarm rates.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, rotation_angle, so3_exp
from station.model.frames import DriveSample, ImuBatch
from station.model.place_answer import HijackEvent
from station.motion.drive_commands import CommandedRest
from station.motion.head import AHEAD, Aim
from station.vision.features import Features, similarities
from station.vision.matching import clearly_nearest

QUIET_NS = 5_000_000_000  # cues so near to each other are of one hijack


@dataclass(frozen=True, slots=True)
class HijackConfig:
    """Thresholds; a floor's bumps, motors' vibration and collisions stay below."""

    bin_s: float = 0.02  # IMU samples are averaged over this: vibration is faster, hands are slower
    settle_s: float = 1.0  # after the first sample, until gravity and biases are known
    gravity_tau_s: float = 3.0
    velocity_tau_s: float = 0.8
    lift_m_s: float = 0.3
    lift_bins: int = 4
    tilt_tau_s: float = 1.5
    tilt_rad: float = 0.12
    turn_rad_s: float = 0.35
    turn_bins: int = 15
    still_s: float = 0.5  # put down: this long without motion
    still_gyro_rad_s: float = 0.03  # roll, pitch and the force along the vertical stay this near to their mean
    still_accel_m_s2: float = 0.3
    still_bias_rad_s: float = 0.2  # a gyroscope at rest may show as much
    view_features: int = 60  # fewer: the view says nothing
    # A view of fewer may be gone after a hand's breadth: a door's frame passed closely. Where the first look at an
    # image finds fewer, those of the second count (vision/features.py); no false alarm came of that
    # (docs/localisation.md).
    view_rich_features: int = 300
    view_ratio: float = 0.7  # nearest against second nearest descriptor
    view_gone: int = 8  # matches below which two views show different things
    view_stays: int = 25
    view_turn_rad: float = 0.15
    view_gap_s: float = 3.0
    view_gap_carried_s: float = 1.0  # without wheels: hands are three times as fast


class HijackDetector:
    """Feed it what arrives; each call returns an event or None. One hijack gives one event."""

    def __init__(self, config: HijackConfig | None = None, has_wheels: bool = True) -> None:
        self.config = config or HijackConfig()
        self._inertial = _InertialCue(self.config, has_wheels)
        gap_s = self.config.view_gap_s if has_wheels else self.config.view_gap_carried_s
        self._views = _ViewCue(self.config, gap_s)
        self._quiet_until_ns = 0
        self._quiet_jumps_until_ns = 0

    @property
    def is_carried(self) -> bool:
        """Between picking up and putting down: images mean nothing now."""
        return self._inertial.is_carried

    def on_imu(self, imu: ImuBatch) -> HijackEvent | None:
        return self._once(self._inertial.add(imu))

    def on_drive(self, drive: DriveSample) -> None:
        self._inertial.command(drive)

    def on_view(self, t_robot_ns: int, features: Features, aim: Aim = AHEAD) -> HijackEvent | None:
        """Features of an image; a few per second are enough. Without a gyroscope nobody knows whether it turned."""
        if self.is_carried or self._inertial.R_start_body is None:
            self._views.forget()
            return None
        R_start_head = self._inertial.R_start_body @ aim.T_body_head[:3, :3]
        return self._once(self._views.add(_View(t_robot_ns, features, R_start_head)))

    def on_jump(self, t_robot_ns: int, distance_m: float, is_other_map: bool, moved: float) -> HijackEvent | None:
        """The current place's estimate went over to a position where the robot cannot have driven.

        No hijack where it is likelier that the position before had been false; `moved`: the probability that it is one.
        """
        if moved < 0.5:
            return None
        where = "in another map than it was in" if is_other_map else f"{distance_m:.1f} m away from where it was"
        if t_robot_ns < max(self._quiet_until_ns, self._quiet_jumps_until_ns):
            return None
        # Of jumps only: it stands there, and a hand that takes it after that is another hijack.
        self._quiet_jumps_until_ns = t_robot_ns + QUIET_NS
        self._views.forget()
        return HijackEvent(t_robot_ns, "position", f"recognised {where}", moved)

    def _once(self, event: HijackEvent | None) -> HijackEvent | None:
        """Cues of the same hijack are one event."""
        if event is None or event.t_robot_ns < self._quiet_until_ns:
            return None
        self._quiet_until_ns = event.t_robot_ns + QUIET_NS
        self._views.forget()
        return event


class _InertialCue:
    """Lifted, tilted, or turned while the motors rest: of a robot on wheels. And how far it turned, of any rig."""

    def __init__(self, config: HijackConfig, has_wheels: bool) -> None:
        self._c = config
        self._has_wheels = has_wheels
        self.is_carried = False
        self.R_start_body: FloatArray | None = None  # (3, 3) by the gyroscope; None before its first sample
        self._start_ns: int | None = None
        self._end_ns = 0
        self._pending: list[tuple[int, FloatArray, FloatArray]] = []
        self._up: FloatArray | None = None  # gravity's reaction (3,) m/s^2 in the body
        self._bias = np.zeros(3)
        self._velocity = 0.0
        self._tilt = np.zeros(3)
        self._lift_count = self._turn_count = 0
        self._recent: deque[tuple[float, FloatArray, FloatArray]] = deque()  # while carried: seconds, gyro, accel
        self._rest = CommandedRest()

    def command(self, drive: DriveSample) -> None:
        self._rest.add_drive(drive)

    def add(self, imu: ImuBatch) -> HijackEvent | None:
        event = None
        for k in range(len(imu)):
            t = int(imu.t_robot_ns[k])
            if self._start_ns is None:
                self._start_ns = self._end_ns = t
            self._pending.append((t, imu.gyro_imu[k], imu.accel_imu[k]))
            if t - self._end_ns >= self._c.bin_s * 1e9:
                gyro = np.mean([p[1] for p in self._pending], axis=0)
                accel = np.mean([p[2] for p in self._pending], axis=0)
                seconds = min((t - self._end_ns) / 1e9, 0.2)  # a gap in the data is no motion
                self._pending, self._end_ns = [], t
                event = self._bin(t, seconds, gyro, accel) or event
        return event

    def _bin(self, t: int, seconds: float, gyro: FloatArray, accel: FloatArray) -> HijackEvent | None:
        c = self._c
        assert self._start_ns is not None
        if self._up is None or self.R_start_body is None:
            self._up, self.R_start_body = accel.copy(), np.eye(3)
        settling = t - self._start_ns < c.settle_s * 1e9
        self._learn(t, seconds, gyro, accel, settling)
        vertical = self._up / max(float(np.linalg.norm(self._up)), 1e-9)
        rate = gyro - self._bias
        self.R_start_body = self.R_start_body @ so3_exp(rate * seconds)
        if settling or not self._has_wheels:
            return None
        surplus = float(vertical @ (accel - self._up))
        self._velocity = (self._velocity + surplus * seconds) * float(np.exp(-seconds / c.velocity_tau_s))
        level = rate - vertical * (vertical @ rate)
        self._tilt = (self._tilt + level * seconds) * float(np.exp(-seconds / c.tilt_tau_s))
        self._lift_count = self._lift_count + 1 if abs(self._velocity) > c.lift_m_s else 0
        resting = self._rest.is_resting(t)
        self._turn_count = self._turn_count + 1 if resting and abs(float(vertical @ rate)) > c.turn_rad_s else 0
        if self.is_carried:
            self._wait_for_rest(t, seconds, gyro, accel)
            return None
        reason = self._reason()
        if reason is None:
            return None
        self.is_carried = True
        self._recent.clear()
        return HijackEvent(t, "imu", reason, 0.99)

    def _reason(self) -> str | None:
        if self._lift_count >= self._c.lift_bins:
            return f"lifted: the robot moves {'up' if self._velocity > 0 else 'down'} at {abs(self._velocity):.1f} m/s"
        tilt = float(np.linalg.norm(self._tilt))
        if tilt > self._c.tilt_rad:
            return f"tilted by {np.degrees(tilt):.0f} degrees"
        if self._turn_count >= self._c.turn_bins:
            return "turned while the motors rest"
        return None

    def _learn(self, t: int, seconds: float, gyro: FloatArray, accel: FloatArray, settling: bool) -> None:
        """Gravity in the body and the gyro's bias; slowly, and not while somebody holds the robot."""
        assert self._up is not None
        if self.is_carried:
            return
        share = 1 - float(np.exp(-seconds / (0.3 if settling else self._c.gravity_tau_s)))
        self._up = self._up + share * (accel - self._up)
        if self._rest.is_resting(t) and float(np.linalg.norm(gyro - self._bias)) < (0.2 if settling else 0.05):
            self._bias = self._bias + share * (gyro - self._bias)

    def _wait_for_rest(self, t: int, seconds: float, gyro: FloatArray, accel: FloatArray) -> None:
        """Put down: for half a second nothing changes but the rate about the vertical; wheels may drive on at once.

        Gravity and bias are learnt anew then, as at the start. What was believed of them is not asked: where hands came
        before it was learnt, no rest would ever look like one.
        """
        c = self._c
        self._recent.append((seconds, gyro, accel))
        while sum(s for s, _, _ in self._recent) - self._recent[0][0] >= c.still_s:
            self._recent.popleft()
        if sum(s for s, _, _ in self._recent) < c.still_s:
            return
        rates, forces = (np.array([one[k] for one in self._recent]) for k in (1, 2))
        vertical = forces.mean(axis=0) / max(float(np.linalg.norm(forces.mean(axis=0))), 1e-9)
        level = rates - np.outer(rates @ vertical, vertical)
        if (
            float(np.linalg.norm(level.mean(axis=0))) < c.still_bias_rad_s
            and _spread(level) < c.still_gyro_rad_s
            and _spread(forces @ vertical) < c.still_accel_m_s2
        ):
            self.is_carried, self._start_ns = False, t
            self._velocity, self._tilt = 0.0, np.zeros(3)
            self._lift_count = self._turn_count = 0


def _spread(x: FloatArray) -> float:
    """Root mean square distance of values or vectors (n, ...) from their mean."""
    return float(np.sqrt(np.square(x - x.mean(axis=0)).reshape(len(x), -1).sum(axis=1).mean()))


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    t_robot_ns: int
    features: Features
    R_start_head: FloatArray  # (3, 3) of what the camera is fixed to


class _ViewCue:
    """The old view is gone without a turn, and the new one stays."""

    def __init__(self, config: HijackConfig, gap_s: float) -> None:
        self._c = config
        self._gap_s = gap_s
        self._before: _View | None = None  # the last trusted view
        self._after: _View | None = None  # a view that does not match it

    def forget(self) -> None:
        self._before = self._after = None

    def add(self, now: _View) -> HijackEvent | None:
        c = self._c
        if len(now.features) < c.view_features:
            return None  # dark or covered: the last good view stays the reference
        before = self._before
        if before is None or not self._compares(before, now):
            self._before, self._after = now, None
            return None
        if _common(before.features, now.features, c.view_ratio) >= c.view_gone:
            self._before, self._after = now, None
            return None
        if self._after is None or _common(self._after.features, now.features, c.view_ratio) < c.view_stays:
            self._after = now
            return None
        return HijackEvent(now.t_robot_ns, "vision", "another view from one moment to the next, without a turn", 0.9)

    def _compares(self, before: _View, now: _View) -> bool:
        """Whether something of that view must still be there now."""
        is_recent = now.t_robot_ns - before.t_robot_ns <= self._gap_s * 1e9
        turned = rotation_angle(before.R_start_head.T @ now.R_start_head)
        is_rich = len(before.features) >= self._c.view_rich_features
        return is_recent and is_rich and bool(turned <= self._c.view_turn_rad)


def _common(a: Features, b: Features, ratio: float) -> int:
    """Mutual nearest features that are clearly nearer than the second nearest."""
    similarity = similarities(a, b)
    rows, columns = clearly_nearest(similarity, ratio)
    return int(np.count_nonzero(similarity[:, columns].argmax(axis=0) == rows))
