"""Inertial readings between two poses as one measurement (docs/slam.md, sec. 7).

Source: Forster et al., IEEE T-RO 33(1), 2017; thesis eq. 2.11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray
from station.slam.ukf import lie
from station.slam.ukf.propagation import ImuSegment, integrate

BIAS_STEP = 1e-5  # rad/s and m/s^2, for derivatives by central differences


@dataclass(frozen=True, slots=True, eq=False)
class Preintegration:
    """Motion in the first pose's body frame, without gravity, at the bias it was integrated with."""

    duration_s: float
    dR: FloatArray  # (3, 3)
    dv: FloatArray  # (3,)
    dp: FloatArray  # (3,)
    dR_by_bias: FloatArray  # (3, 3) rotation vector (right side) by gyro bias
    dv_by_bias: FloatArray  # (3, 6) by gyro and accel bias
    dp_by_bias: FloatArray  # (3, 6)
    covariance: FloatArray  # (9, 9) of (phi on the right, v, p)
    bias: FloatArray  # (6,) gyro, accel

    @property
    def sqrt_information(self) -> FloatArray:
        """W (9, 9) with W^T W = covariance^-1."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    def at(self, bias: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """dR, dv, dp at a nearby bias, to first order."""
        d = bias - self.bias
        return (
            self.dR @ lie.so3_exp(self.dR_by_bias @ d[:3]),
            self.dv + self.dv_by_bias @ d,
            self.dp + self.dp_by_bias @ d,
        )


def preintegrate(imu: ImuSegment, bias: FloatArray, noise: ImuNoise) -> Preintegration:
    """Integrate a segment from identity, with derivatives by the bias and covariance."""
    steps = np.concatenate([np.zeros((1, 6)), np.eye(6) * BIAS_STEP, -np.eye(6) * BIAS_STEP])
    biases = bias + steps
    zero = np.zeros((13, 3))
    identity = np.broadcast_to(np.eye(3), (13, 3, 3))
    Rs, vs, ps = integrate(identity, zero, zero, biases[:, :3], biases[:, 3:], imu, 0.0)
    turn = lie.so3_log(Rs[-1, 0].T @ Rs[-1, 1:])
    cov = _covariance(Rs[:, 0], imu, bias, noise)
    return Preintegration(
        duration_s=float(imu.dt_s.sum()),
        dR=Rs[-1, 0],
        dv=vs[-1, 0],
        dp=ps[-1, 0],
        dR_by_bias=((turn[:3] - turn[6:9]) / (2.0 * BIAS_STEP)).T,
        dv_by_bias=((vs[-1, 1:7] - vs[-1, 7:]) / (2.0 * BIAS_STEP)).T,
        dp_by_bias=((ps[-1, 1:7] - ps[-1, 7:]) / (2.0 * BIAS_STEP)).T,
        covariance=cov,
        bias=bias,
    )


def _covariance(Rs: FloatArray, imu: ImuSegment, bias: FloatArray, noise: ImuNoise) -> FloatArray:
    """(9, 9) of (phi on the right, v, p). Forster et al., eq. A.9."""
    turn = (imu.gyro - bias[:3]) * imu.dt_s[:, None]
    dt = imu.dt_s[:, None, None]
    A = np.broadcast_to(np.eye(9), (len(turn), 9, 9)).copy()
    A[:, :3, :3] = np.swapaxes(lie.so3_exp(turn), 1, 2)
    A[:, 3:6, :3] = -dt * (Rs[:-1] @ lie.skew(imu.accel - bias[3:]))
    A[:, 6:, :3] = 0.5 * dt * A[:, 3:6, :3]
    A[:, 6:, 3:6] = dt * np.eye(3)
    B = np.zeros((len(turn), 9, 6))
    B[:, :3, :3] = lie.so3_left_jacobian(-turn)
    B[:, 3:6, 3:] = Rs[:-1]
    B[:, 6:, 3:] = 0.5 * dt * Rs[:-1]
    density = np.repeat(np.array([noise.gyro_density, noise.accel_density]) * imu.noise_scale, 3, axis=1)
    Q = (B * (density**2 * imu.dt_s[:, None])[:, None, :]) @ np.swapaxes(B, 1, 2)
    P = np.zeros((9, 9))
    for step, added in zip(A, Q, strict=True):
        P = step @ P @ step.T + added
    P[6:, 6:] += np.eye(3) * 1e-12
    return P + np.eye(9) * 1e-14


def chain(a: Preintegration, b: Preintegration) -> Preintegration:
    """Two consecutive measurements as one; both must have been integrated with about the same bias."""
    T = b.duration_s
    turned_v, turned_p = a.dR @ lie.skew(b.dv), a.dR @ lie.skew(b.dp)
    dv_by_bias = a.dv_by_bias + a.dR @ b.dv_by_bias
    dv_by_bias[:, :3] -= turned_v @ a.dR_by_bias
    dp_by_bias = a.dp_by_bias + T * a.dv_by_bias + a.dR @ b.dp_by_bias
    dp_by_bias[:, :3] -= turned_p @ a.dR_by_bias
    A, B = np.eye(9), np.zeros((9, 9))
    A[:3, :3] = b.dR.T
    A[3:6, :3], A[6:, :3] = -turned_v, -turned_p
    A[6:, 3:6] = T * np.eye(3)
    B[:3, :3] = np.eye(3)
    B[3:6, 3:6] = B[6:, 6:] = a.dR
    return Preintegration(
        duration_s=a.duration_s + T,
        dR=a.dR @ b.dR,
        dv=a.dv + a.dR @ b.dv,
        dp=a.dp + a.dv * T + a.dR @ b.dp,
        dR_by_bias=b.dR.T @ a.dR_by_bias + b.dR_by_bias,
        dv_by_bias=dv_by_bias,
        dp_by_bias=dp_by_bias,
        covariance=A @ a.covariance @ A.T + B @ b.covariance @ B.T,
        bias=a.bias,
    )


def compose(parts: list[Preintegration]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Motion from the first pose to each of the N + 1 poses: R (N + 1, 3, 3), v, p (N + 1, 3), times (N + 1,)."""
    R, v, p, t = [np.eye(3)], [np.zeros(3)], [np.zeros(3)], [0.0]
    for part in parts:
        p.append(p[-1] + v[-1] * part.duration_s + R[-1] @ part.dp)
        v.append(v[-1] + R[-1] @ part.dv)
        R.append(R[-1] @ part.dR)
        t.append(t[-1] + part.duration_s)
    return np.array(R), np.array(v), np.array(p), np.array(t)
