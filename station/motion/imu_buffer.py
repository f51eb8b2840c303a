"""The stream of inertial samples: checks what comes in, cuts out what lies between two times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray
from station.model.frames import ImuBatch
from station.motion.preintegration import ImuSegment

MAX_ACCEL = 1000.0  # m/s^2; no IMU of ours reads more, but a broken file may
MAX_GYRO = 100.0  # rad/s
NOISE_WINDOW_NS = 500_000_000


@dataclass(frozen=True, slots=True)
class Shaking:
    """How what shakes the sensor is measured, and how much of it is noise: of its own motion it reads the truth."""

    block_s: float  # it is measured over means of so many seconds of samples; 0: from sample to sample
    noise_share: float  # of its standard deviation, from picture to picture
    link_share: float  # the same where keyframes are linked over seconds
    by_axis: bool  # else each of a sensor's three counts as noisy as they are on the whole


# Propellers shake the whole rig, in tones: nearly all of it is motion that integrates to nothing. Of EuRoC's flight it
# makes the noise about 2 (gyroscope) and 4 (accelerometer) times the data sheet's. Which axis the tones are strong in
# does not say which one they leave a tenth in: axis by axis the filter followed that flight within 26 mm, else 17.
# Some of it comes back as a bias that comes and goes, which weighs on a problem of many seconds: against the truth of
# two EuRoC flights the Allan deviation at 0.5 and 1 s is what 0.17 to 0.29 of the shaking would leave as white noise
# (docs/studies/ukf-map.md). The filter with that share was worse off.
IN_THE_AIR = Shaking(block_s=0.0, noise_share=0.1, link_share=0.2, by_axis=False)
# Motors, gears and floor shake a small robot's IMU at all frequencies, more than its body. Means of 0.02 s hardly bend
# with its own motion, and what does not average out within them does not in the estimate either. A floor shakes upward,
# and the level axes tell the scale.
ON_WHEELS = Shaking(block_s=0.02, noise_share=1.0, link_share=1.0, by_axis=True)


@dataclass(slots=True)
class ImuCounts:
    """What was refused, and what was patched."""

    not_finite: int = 0
    out_of_order: int = 0
    saturated: int = 0
    gaps: int = 0
    longest_gap_s: float = 0.0


class ImuBuffer:
    def __init__(self, noise: ImuNoise, shaking: Shaking = IN_THE_AIR, keep_s: float = 4.0) -> None:
        self._noise = noise
        self._shaking = shaking
        self._keep_ns = int(keep_s * 1e9)
        self._t: IntArray = np.zeros(0, dtype=np.int64)
        self._gyro: FloatArray = np.zeros((0, 3))
        self._accel: FloatArray = np.zeros((0, 3))
        self.counts = ImuCounts()
        self._expected_dt_s = 1.0 / noise.rate_hz

    def __len__(self) -> int:
        return len(self._t)

    @property
    def last_t_ns(self) -> int | None:
        return int(self._t[-1]) if len(self._t) else None

    @property
    def first_t_ns(self) -> int | None:
        return int(self._t[0]) if len(self._t) else None

    def add(self, imu: ImuBatch) -> None:
        """Append samples; those that are not numbers, absurd, repeated or late are counted and left out."""
        t, gyro, accel = imu.t_robot_ns, imu.gyro_imu, imu.accel_imu
        finite = np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
        finite &= (np.abs(gyro) < MAX_GYRO).all(axis=1) & (np.abs(accel) < MAX_ACCEL).all(axis=1)
        self.counts.not_finite += int((~finite).sum())
        t, gyro, accel = t[finite], gyro[finite], accel[finite]
        if not len(t):
            return
        last = self._t[-1] if len(self._t) else t[0] - 1
        before = np.maximum.accumulate(np.concatenate([[last], t]))[:-1]
        fresh = t > before
        self.counts.out_of_order += int((~fresh).sum())
        self._count(t[fresh], gyro[fresh], accel[fresh])
        self._t = np.concatenate([self._t, t[fresh]])
        self._gyro = np.concatenate([self._gyro, gyro[fresh]])
        self._accel = np.concatenate([self._accel, accel[fresh]])

    def _count(self, t: IntArray, gyro: FloatArray, accel: FloatArray) -> None:
        """Gaps before new samples and those at the sensor's range, once each however often they are integrated."""
        dt_s = np.diff(t, prepend=self._t[-1:]) * 1e-9
        gap = self._is_gap(dt_s)
        if gap.any():
            self.counts.gaps += int(gap.sum())
            self.counts.longest_gap_s = max(self.counts.longest_gap_s, float(dt_s.max()))
        self.counts.saturated += int(self._is_at_range(gyro, accel).sum())

    def _is_gap(self, dt_s: FloatArray) -> npt.NDArray[np.bool_]:
        return np.asarray(dt_s > 2.5 * self._expected_dt_s)

    def _is_at_range(self, gyro: FloatArray, accel: FloatArray) -> npt.NDArray[np.bool_]:
        limit = 0.999 * np.repeat([self._noise.gyro_range, self._noise.accel_range], 3)
        return np.asarray((np.abs(np.hstack([gyro, accel])) >= limit).any(axis=1))

    def forget_before(self, t_ns: int) -> None:
        """Drop what ended before t_ns; one earlier sample stays for interpolation."""
        start = max(0, int(np.searchsorted(self._t, t_ns)) - 1)
        self._t, self._gyro, self._accel = self._t[start:], self._gyro[start:], self._accel[start:]

    def samples(self, start_ns: int, end_ns: int) -> ImuBatch:
        """Samples within [start, end], with forces in place of the accelerometer's readings."""
        a, b = np.searchsorted(self._t, [start_ns, end_ns + 1])
        return ImuBatch(self._t[a:b], self._gyro[a:b], self._noise.forces(self._accel[a:b]))

    def segment(self, start_ns: int, end_ns: int, is_link: bool = False) -> ImuSegment:
        """Steps from start to end: means of neighbouring samples, interpolated at both ends; forces, as in `samples`.

        Before the first and after the last sample their values are held. A gap is one long interpolated step whose
        noise grows with the gap; readings at the sensor's range get ten times the noise.
        is_link: between keyframes of a problem that spans seconds (see Shaking).
        """
        inside = (self._t > start_ns) & (self._t < end_ns)
        t = np.concatenate([[start_ns], self._t[inside], [end_ns]])
        gyro = np.vstack([self._at(start_ns, self._gyro), self._gyro[inside], self._at(end_ns, self._gyro)])
        accel = np.vstack([self._at(start_ns, self._accel), self._accel[inside], self._at(end_ns, self._accel)])
        dt = np.diff(t) * 1e-9
        scale = np.broadcast_to(self._noise_scale(start_ns, end_ns, is_link), (len(dt), 6)).copy()
        gap = self._is_gap(dt)
        if gap.any():
            # Motion between the ends is unknown: about 1 m/s^2 and 1 rad/s^2 of change, far above the white noise.
            scale[gap] += 100.0 * dt[gap, None] / self._expected_dt_s
        at_range = self._is_at_range(gyro, accel)
        if at_range.any():
            scale[at_range[:-1] | at_range[1:]] *= 10.0
        if end_ns <= start_ns:
            dt, gyro, accel, scale = dt[:0], gyro[:1], accel[:1], scale[:0]
        return ImuSegment(
            dt_s=dt,
            gyro=0.5 * (gyro[:-1] + gyro[1:]),
            accel=self._noise.forces(0.5 * (accel[:-1] + accel[1:])),
            end_t_ns=end_ns,
            end_gyro=gyro[-1],
            noise_scale=scale,
        )

    def _noise_scale(self, start_ns: int, end_ns: int, is_link: bool) -> FloatArray:
        """How much larger (6,) the noise of each gyro and accel axis is than on a resting sensor, from the data alone.

        The third difference of neighbouring means removes motion and keeps noise.
        """
        block = max(1, round(self._shaking.block_s / self._expected_dt_s))
        a, b = np.searchsorted(self._t, [start_ns - NOISE_WINDOW_NS, end_ns + 1]).tolist()
        count = (b - a) // block
        if count < 8:
            return np.ones(6)
        values = np.hstack([self._gyro[b - count * block : b], self._accel[b - count * block : b]])
        means = values.reshape(count, block, 6).mean(axis=1)
        third = means[3:] - 3.0 * means[2:-1] + 3.0 * means[1:-2] - means[:-3]
        power = (third * third).mean(axis=0) / 20.0  # 1 + 9 + 9 + 1
        if not self._shaking.by_axis:
            power = np.repeat(power.reshape(2, 3).mean(axis=1), 3)
        at_rest = self._noise.densities / np.sqrt(block * self._expected_dt_s)
        measured = power / at_rest**2
        share = self._shaking.link_share if is_link else self._shaking.noise_share
        return np.sqrt(1.0 + share**2 * np.maximum(measured - 1.0, 0.0))

    def _at(self, t_ns: int, values: FloatArray) -> FloatArray:
        """Value (3,) at a time, linear between samples, held beyond them; zero without any."""
        if not len(self._t):
            return np.zeros(3)
        right = int(np.searchsorted(self._t, t_ns))
        if right == 0:
            return values[0]
        if right == len(self._t):
            return values[-1]
        span = float(self._t[right] - self._t[right - 1])
        weight = float(t_ns - self._t[right - 1]) / span
        return (1.0 - weight) * values[right - 1] + weight * values[right]
