"""Inertial samples of a whole navigation integrated once, so that any two times can be compared at once.

For a recorded navigation, many pairs of times, and one bias. Of each pair it says the motion and how the motion
depends on the bias, not how sure it is: preintegration.py gives one interval with its covariance.
Source: Forster et al., On-manifold preintegration, IEEE T-RO 33(1), 2017, eqs. 33-38, as cumulative sums: with
R(t) = R_start_body(t), V = int R a, P = int V, what happened between two times is a difference of V and P.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, IntArray, so3_exp
from station.model.frames import ImuBatch

MAX_GAP_S = 0.1  # samples further apart: what happened between is unknown


def concatenate_imu(batches: list[ImuBatch]) -> ImuBatch | None:
    """One batch of all; None where there are fewer than two samples."""
    if sum(len(batch) for batch in batches) < 2:
        return None
    return ImuBatch(
        np.concatenate([batch.t_robot_ns for batch in batches]),
        np.concatenate([batch.gyro_imu for batch in batches]),
        np.concatenate([batch.accel_imu for batch in batches]),
    )


class InertialTrack:
    """Rotation, velocity and position increments since the first sample, without gravity and initial motion."""

    def __init__(self, imu: ImuBatch, gyro_bias: FloatArray) -> None:
        self.t_ns: IntArray = imu.t_robot_ns
        self.gyro_bias = gyro_bias
        self._imu = imu
        dt = np.diff(imu.t_robot_ns) * 1e-9
        self.gap_ends = np.flatnonzero(dt > MAX_GAP_S) + 1
        rate = 0.5 * (imu.gyro_imu[1:] + imu.gyro_imu[:-1]) - gyro_bias
        self.R = _chain(rate * dt[:, None])  # (N, 3, 3) R_start_body
        accel = np.einsum("nij,nj->ni", self.R, imu.accel_imu)
        self._velocity = _integrate(accel, dt)
        self._position = _integrate(self._velocity, dt)
        self._R_sum = _integrate(self.R, dt)  # derivative of velocity by the accelerometer's bias, negative
        self._R_sum_sum = _integrate(self._R_sum, dt)

    def with_bias(self, gyro_bias: FloatArray) -> InertialTrack:
        return InertialTrack(self._imu, gyro_bias)

    def covers(self, t_ns: IntArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        return (t_ns >= self.t_ns[0]) & (t_ns <= self.t_ns[-1])

    def has_gap(self, t_begin_ns: int, t_end_ns: int) -> bool:
        """Whether samples are missing between two times."""
        begin, end = np.searchsorted(self.t_ns, [t_begin_ns, t_end_ns])
        return bool(((self.gap_ends >= begin) & (self.gap_ends <= end)).any())

    def rotation_at(self, t_ns: IntArray) -> FloatArray:
        """R_start_body (M, 3, 3) at times within the samples (clamped to them)."""
        t = np.clip(np.asarray(t_ns, dtype=np.int64), self.t_ns[0], self.t_ns[-1])
        k = np.clip(np.searchsorted(self.t_ns, t, side="right") - 1, 0, len(self.t_ns) - 1)
        rest = (t - self.t_ns[k]) * 1e-9
        following = np.minimum(k + 1, len(self.t_ns) - 1)
        rate = 0.5 * (self._imu.gyro_imu[k] + self._imu.gyro_imu[following]) - self.gyro_bias
        return self.R[k] @ so3_exp(rate * rest[:, None])

    def rate_at(self, t_ns: IntArray) -> FloatArray:
        """Angular velocity (M, 3) rad/s of the body, bias removed."""
        seconds = (self.t_ns - self.t_ns[0]) * 1e-9
        at = (np.asarray(t_ns, dtype=np.int64) - self.t_ns[0]) * 1e-9
        return np.column_stack([np.interp(at, seconds, self._imu.gyro_imu[:, i]) for i in range(3)]) - self.gyro_bias

    def increments(self, t_ns: IntArray) -> Increments:
        """What happened between consecutive times (M,)."""
        R = self.rotation_at(t_ns)
        V, P = self._at(self._velocity, t_ns), self._at(self._position, t_ns)
        W, Y = self._at(self._R_sum, t_ns), self._at(self._R_sum_sum, t_ns)
        dt = np.diff(t_ns) * 1e-9
        back = np.swapaxes(R[:-1], 1, 2)
        return Increments(
            dt=dt,
            R=back @ R[1:],
            velocity=np.einsum("nij,nj->ni", back, V[1:] - V[:-1]),
            position=np.einsum("nij,nj->ni", back, P[1:] - P[:-1] - V[:-1] * dt[:, None]),
            R_sum=back @ (W[1:] - W[:-1]),
            R_sum_sum=back @ (Y[1:] - Y[:-1] - W[:-1] * dt[:, None, None]),
        )

    def _at(self, values: FloatArray, t_ns: IntArray) -> FloatArray:
        """Linear between samples: 5 ms of curvature are 0.03 mm."""
        t = np.clip(np.asarray(t_ns, dtype=np.int64), self.t_ns[0], self.t_ns[-1])
        k = np.clip(np.searchsorted(self.t_ns, t, side="right") - 1, 0, len(self.t_ns) - 2)
        fraction = (t - self.t_ns[k]) / (self.t_ns[k + 1] - self.t_ns[k])
        fraction = fraction.reshape(-1, *([1] * (values.ndim - 1)))
        return (1.0 - fraction) * values[k] + fraction * values[k + 1]


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """Preintegrated motion of intervals, in the body frame at each interval's begin, without gravity."""

    dt: FloatArray  # (M,) s
    R: FloatArray  # (M, 3, 3) R_begin_end
    velocity: FloatArray  # (M, 3) m/s
    position: FloatArray  # (M, 3) m
    R_sum: FloatArray  # (M, 3, 3) s; velocity changes by -R_sum @ accel_bias
    R_sum_sum: FloatArray  # (M, 3, 3) s^2; position changes by -R_sum_sum @ accel_bias


def _chain(steps: FloatArray) -> FloatArray:
    out = np.empty((len(steps) + 1, 3, 3))
    out[0] = R = np.eye(3)
    for k, step in enumerate(so3_exp(steps)):
        R = R @ step
        out[k + 1] = R
    return out


def _integrate(values: FloatArray, dt: FloatArray) -> FloatArray:
    """Cumulative trapezoid along the first axis, 0 at the first sample."""
    shape = (-1, *([1] * (values.ndim - 1)))
    steps = 0.5 * (values[1:] + values[:-1]) * dt.reshape(shape)
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps, axis=0)])


def usable_intervals(
    track: InertialTrack, t_ns: IntArray, max_interval_s: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Which intervals between consecutive times the inertial samples tell about."""
    covered = track.covers(t_ns)
    short = np.diff(t_ns) <= max_interval_s * 1e9
    whole = np.array([not track.has_gap(int(a), int(b)) for a, b in itertools.pairwise(t_ns)], dtype=bool)
    return covered[:-1] & covered[1:] & short & whole
