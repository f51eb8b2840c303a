"""Inertial readings between two poses as one measurement, with its covariance (docs/slam.md, sec. 7).

For least squares while the robot drives: an interval is integrated once, moved to a nearby bias to first order, joined
with the next. inertial_track.py compares any two times of a recorded navigation.
Source: Forster et al., IEEE T-RO 33(1), 2017; thesis eq. 2.11.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, gammas, skew, so3_exp
from station.motion import lie


@dataclass(frozen=True, slots=True, eq=False)
class RolledWay:
    """How far wheels have carried the body: by_constants @ their constants, in the first pose's body frame."""

    by_constants: FloatArray  # (3, c) m
    covariance: FloatArray  # (3, 3) m^2


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
    rolled: RolledWay | None = None  # None: wheels do not say it all the way

    @property
    def sqrt_information(self) -> FloatArray:
        """W (9, 9) with W^T W = covariance^-1."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    def at(self, bias: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """dR, dv, dp at a nearby bias, to first order."""
        d = bias - self.bias
        return (
            self.dR @ so3_exp(self.dR_by_bias @ d[:3]),
            self.dv + self.dv_by_bias @ d,
            self.dp + self.dp_by_bias @ d,
        )


def preintegrate(imu: ImuSegment, bias: FloatArray, noise: ImuNoise) -> Preintegration:
    """Integrate a segment from identity, with derivatives by the bias and covariance.

    All sums over the steps at once: what step k does to the end follows from the poses after it and at the end
    (Forster et al., eqs. 44, A.9 in closed form; products of a step's own turn with itself are left out).
    """
    zero = np.zeros((1, 3))
    Rs, vs, ps = (
        a[:, 0] for a in integrate(np.eye(3)[None], zero, zero, bias[None, :3], bias[None, 3:], imu, 0.0)
    )  # (N + 1, ...)
    turn = (imu.gyro - bias[:3]) * imu.dt_s[:, None]
    force = imu.accel - bias[3:]
    once, twice, right = *gammas(turn, (1, 2)), lie.so3_left_jacobian(-turn)
    dt = imu.dt_s[:, None, None]
    R, force_x = Rs[:-1], skew(force)

    R_after_right = Rs[1:] @ right
    by_gyro = -np.swapaxes(Rs, 1, 2) @ _sums(R_after_right * dt)  # (N + 1, 3, 3): each rotation's derivative
    step_v = -R @ (skew((once @ force[..., None])[..., 0]) @ by_gyro[:-1] - (0.5 * dt) * force_x)
    v_by_bias = _sums(np.concatenate([step_v, -R @ once], axis=2) * dt)  # (N + 1, 3, 6)
    step_p = -R @ (skew((twice @ force[..., None])[..., 0]) @ by_gyro[:-1] - (dt / 6.0) * force_x)
    p_by_bias = np.sum(v_by_bias[:-1] * dt + np.concatenate([step_p, -R @ twice], axis=2) * dt * dt, axis=0)
    return Preintegration(
        duration_s=float(imu.dt_s.sum()),
        dR=Rs[-1],
        dv=vs[-1],
        dp=ps[-1],
        dR_by_bias=by_gyro[-1],
        dv_by_bias=v_by_bias[-1],
        dp_by_bias=p_by_bias,
        covariance=_covariance(Rs, vs, ps, R_after_right, imu, noise),
        bias=bias,
    )


def _sums(steps: FloatArray) -> FloatArray:
    """Sums (N + 1, ...) of the first 0, 1, ... N steps."""
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def _covariance(
    Rs: FloatArray, vs: FloatArray, ps: FloatArray, R_after_right: FloatArray, imu: ImuSegment, noise: ImuNoise
) -> FloatArray:
    """(9, 9) of (phi on the right, v, p): what the white noise of every step does to the end."""
    dt = imu.dt_s[:, None, None]
    left = (imu.dt_s[::-1].cumsum()[::-1] - imu.dt_s)[:, None]  # from the end of the step to the end of the segment
    B = np.zeros((len(imu.dt_s), 9, 6))
    B[:, :3, :3] = Rs[-1].T @ R_after_right
    B[:, 3:6, :3] = -skew(vs[-1] - vs[1:]) @ R_after_right
    B[:, 6:, :3] = -skew(ps[-1] - ps[1:] - vs[1:] * left) @ R_after_right
    B[:, 3:6, 3:] = Rs[:-1]
    B[:, 6:, 3:] = (0.5 * dt + left[..., None]) * Rs[:-1]
    B *= (noise.densities * imu.noise_scale * np.sqrt(imu.dt_s)[:, None])[:, None, :]
    flat = np.swapaxes(B, 0, 1).reshape(9, -1)
    P = flat @ flat.T
    P[6:, 6:] += np.eye(3) * 1e-12
    return np.asarray(P + np.eye(9) * 1e-14)


def chain(a: Preintegration, b: Preintegration) -> Preintegration:
    """Two consecutive measurements as one, at the bias of the first."""
    dR, dv, dp = b.at(a.bias)
    b = replace(b, dR=dR, dv=dv, dp=dp, bias=a.bias)
    T = b.duration_s
    turned_v, turned_p = a.dR @ skew(b.dv), a.dR @ skew(b.dp)
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
        rolled=_rolled_on(a, b),
    )


def _rolled_on(a: Preintegration, b: Preintegration) -> RolledWay | None:
    if a.rolled is None or b.rolled is None:
        return None
    return RolledWay(
        a.rolled.by_constants + a.dR @ b.rolled.by_constants,
        a.rolled.covariance + a.dR @ b.rolled.covariance @ a.dR.T,
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


@dataclass(frozen=True, slots=True, eq=False)
class ImuSegment:
    """Inertial readings over consecutive steps, each the mean over its step."""

    dt_s: FloatArray  # (N,)
    gyro: FloatArray  # (N, 3) rad/s, with bias
    accel: FloatArray  # (N, 3) m/s^2, with bias
    end_t_ns: int
    end_gyro: FloatArray  # (3,) reading at the end
    noise_scale: FloatArray  # (N, 6) >= 1: so much larger is the noise of each axis (vibration, gaps, saturation)


def integrate(
    R: FloatArray,
    v: FloatArray,
    x: FloatArray,
    bias_gyro: FloatArray,
    bias_accel: FloatArray,
    imu: ImuSegment,
    gravity: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses and velocities after every step, batched: (N + 1, K, ...) from R (K, 3, 3), v, x and biases (K, 3).

    Closed form for readings that are constant over a step in the body frame, instead of Euler's (thesis eq. B.13).
    """
    dt = imu.dt_s[:, None]
    rate = imu.gyro[:, None] - bias_gyro[None]  # (N, K, 3)
    force = imu.accel[:, None] - bias_accel[None]
    turn = rate * dt[..., None]
    dR, once, twice = gammas(turn, (0, 1, 2))
    dv = (once @ force[..., None])[..., 0] * dt[..., None]
    dx = (twice @ force[..., None])[..., 0] * (dt * dt)[..., None]
    fall = np.array([0.0, 0.0, -gravity])
    N, K = len(imu.dt_s), len(R)
    Rs, vs, xs = np.empty((N + 1, K, 3, 3)), np.empty((N + 1, K, 3)), np.empty((N + 1, K, 3))
    Rs[0], vs[0], xs[0] = R, v, x
    for k in range(N):
        np.matmul(Rs[k], dR[k], out=Rs[k + 1])
    turned = Rs[:-1]
    step_v = (turned @ dv[..., None])[..., 0] + fall * dt[..., None]
    vs[1:] = v + np.cumsum(step_v, axis=0)
    step_x = (turned @ dx[..., None])[..., 0] + vs[:-1] * dt[..., None] + fall * (0.5 * dt * dt)[..., None]
    xs[1:] = x + np.cumsum(step_x, axis=0)
    return Rs, vs, xs
