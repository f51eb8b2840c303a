"""Where a pan-tilt head has the camera at any time: by what its servos were told, and by how far they are off.

The frames are those of shared/head.py. A hobby servo is off by a smooth function of its angle, the same each time it is
there; it follows a little later or earlier than its calibration tells; and by backlash and trembling it is off by what
nobody can foresee. The first two are constants of the servos, which a filter learns as it goes.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from shared.calibration import HeadCalibration
from shared.geometry import FloatArray, skew
from shared.head import turned
from station.model.frames import DriveSample

REPORT_NS = 80_000_000  # reports come every 50 to 67 ms; over a longer silence nothing had changed
MEMORY_NS = 30_000_000_000  # frames may wait that long for their turn
SETTLE_NS = 100_000_000  # so long a servo takes to follow a change of speed
CORRELATION_RAD = np.radians(20.0)  # so far apart two angles have errors of their own
# The error at these angles is learned; in between the curve is taken for straight, which is off by less than the play.
PAN_KNOTS, TILT_KNOTS = np.radians(np.arange(-75.0, 76.0, 7.5)), np.radians(np.arange(-45.0, 46.0, 7.5))
SIGMA_LAG_S = 0.02  # between one servo and another
# What nobody can foresee: how large it gets, and by how much it changes
SIGMA_PLAY_RAD = np.radians(0.4)
PLAY_PER_TURN = 0.02  # share of a turn
PLAY_PER_SPEED_S = 0.01  # s, times a change of speed
TREMBLE_RAD = np.radians(0.3)  # per square root of a second: a servo at rest trembles by a tenth of a degree

PLAY = slice(0, 2)
NUM_CONSTANTS = len(PAN_KNOTS) + len(TILT_KNOTS) + 1  # the lag comes last
NUM_ERRORS = 2 + NUM_CONSTANTS


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """Where the head had the camera when an image was taken."""

    T_body_head: FloatArray  # (4, 4)
    sigma_rad: float  # of its rotation


AHEAD = Aim(np.eye(4), 0.0)  # and where the camera is fixed to the body


@dataclass(frozen=True, slots=True, eq=False)
class HeadPose:
    """A head at one time, as it was told."""

    calibration: HeadCalibration
    angles: FloatArray  # (2,) rad, pan and tilt
    rates: FloatArray  # (2,) rad/s
    sigma_change: FloatArray  # (2,) rad, by how much the play of both servos changed since the time before

    @property
    def is_turning(self) -> bool:
        return bool(self.rates.any())

    @property
    def by_errors(self) -> FloatArray:
        """(2, NUM_ERRORS), how far pan and tilt are off by play (2), errors at the knots, and lag."""
        out = np.zeros((2, NUM_ERRORS))
        out[:, PLAY] = np.eye(2)
        at = 2
        for axis, knots in enumerate((PAN_KNOTS, TILT_KNOTS)):
            out[axis, at : at + len(knots)] = _shares(knots, float(self.angles[axis]))
            at += len(knots)
        out[:, at] = -self.rates
        return out

    def T_body_head(self, off: FloatArray) -> FloatArray:
        """(4, 4), of angles that are `off` (2,) larger than told."""
        pan, tilt = (self.angles + off).tolist()
        return turned(self.calibration, pan, tilt)

    def by_angles(self, off: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How T_body_head changes with the angles: rotation vectors (3, 2) and displacements (3, 2), in body axes."""
        pan = float(self.angles[0] + off[0])
        axes = np.array([[0.0, np.sin(pan)], [0.0, -np.cos(pan)], [1.0, 0.0]])  # the body's z, the panned head's -y
        t = self.T_body_head(off)[:3, 3]
        return axes, -skew(t - np.array(self.calibration.pivot_body)) @ axes


@dataclass(frozen=True, slots=True, eq=False)
class HeadThen:
    """A head at a time that lies back: of its servos more has been learned since, of the play it had no more."""

    told: HeadPose
    play: FloatArray  # (2,) rad, as it was estimated then

    def T_body_head(self, errors: FloatArray) -> FloatArray:
        """(4, 4), by the servos' errors (NUM_ERRORS,) as they are known by now."""
        errors = errors.copy()
        errors[PLAY] = self.play
        return self.told.T_body_head(self.told.by_errors @ errors)


def _shares(knots: FloatArray, angle: float) -> FloatArray:
    """(K,) of each knot's value in that at an angle: evenly between two, the last one's beyond."""
    right = min(max(int(np.searchsorted(knots, angle)), 1), len(knots) - 1)
    share = min(max((angle - knots[right - 1]) / (knots[right] - knots[right - 1]), 0.0), 1.0)
    out = np.zeros(len(knots))
    out[right - 1], out[right] = 1.0 - share, share
    return out


def errors_before_the_drive(head: HeadCalibration) -> FloatArray:
    """Root (NUM_ERRORS, NUM_ERRORS) of the covariance of servos that nobody has measured.

    Smooth functions of the angle (Gaussian processes, squared-exponential), none straight ahead: there the camera's
    mounting was measured.
    """
    out = np.zeros((NUM_ERRORS, NUM_ERRORS))
    out[PLAY, PLAY] = 0.5 * SIGMA_PLAY_RAD * np.eye(2)
    at = 2
    for knots in (PAN_KNOTS, TILT_KNOTS):
        K = np.exp(-0.5 * ((knots[:, None] - knots) / CORRELATION_RAD) ** 2)
        ahead = K[:, len(knots) // 2]
        K = K - np.outer(ahead, ahead) + 1e-4 * np.eye(len(knots))
        rows = slice(at, at + len(knots))
        out[rows, rows] = head.sigma * np.linalg.cholesky(K)
        at += len(knots)
    out[at, at] = SIGMA_LAG_S
    return out


class HeadTrack:
    """What the servos of one head were told. Pure: the samples' time only."""

    def __init__(self, calibration: HeadCalibration | None) -> None:
        self._calibration = calibration
        self._samples: list[tuple[int, float, float]] = []
        self._is_used = False

    def add(self, drive: DriveSample) -> None:
        """Samples out of time order are left out."""
        if self._samples and drive.t_robot_ns <= self._samples[-1][0]:
            return
        self._is_used = self._is_used or bool(drive.pan_rad or drive.tilt_rad)
        self._samples.append((drive.t_robot_ns, drive.pan_rad, drive.tilt_rad))
        if self._samples[len(self._samples) // 2][0] < drive.t_robot_ns - MEMORY_NS:
            del self._samples[: len(self._samples) // 2]

    def pose(self, t_ns: int, since_ns: int) -> HeadPose | None:
        """The head at a time, given the time of the image before; None while it was never turned, and where none is."""
        head = self._calibration
        if head is None or not self._is_used:
            return None
        angles, rates = self._angles(t_ns), self._rates(t_ns)
        by_turn = PLAY_PER_TURN * (angles - self._angles(since_ns))
        by_speed = PLAY_PER_SPEED_S * (rates - self._rates(since_ns - SETTLE_NS))
        trembling = TREMBLE_RAD**2 * max(t_ns - since_ns, 0) * 1e-9
        return HeadPose(head, angles, rates, np.sqrt(by_turn**2 + by_speed**2 + trembling))

    def _rates(self, t_ns: int) -> FloatArray:
        half_ns = REPORT_NS // 2
        return (self._angles(t_ns + half_ns) - self._angles(t_ns - half_ns)) / (2e-9 * half_ns)

    def _angles(self, t_ns: int) -> FloatArray:
        """Pan and tilt (2,): as they were told one lag ago, evenly on the way between two reports."""
        assert self._calibration is not None
        t_ns -= round(self._calibration.lag_s * 1e9)
        count = bisect_right(self._samples, t_ns, key=lambda sample: sample[0])
        before, after = self._samples[max(count - 1, 0)], self._samples[min(count, len(self._samples) - 1)]
        begin_ns = max(before[0], after[0] - REPORT_NS)
        share = min(max((t_ns - begin_ns) / max(after[0] - begin_ns, 1), 0.0), 1.0)
        return np.array([a + share * (b - a) for a, b in zip(before[1:], after[1:], strict=True)])
