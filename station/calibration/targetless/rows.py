"""What was measured against what the unknowns predict: whitened residuals and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, skew, so3_exp, so3_log
from station.calibration.camera_imu.projection import Projection
from station.calibration.camera_imu.rows import Samples
from station.calibration.targetless.tracks import Sightings
from station.calibration.targetless.unknowns import STATE, Estimate, across
from station.model.frames import ImuBatch
from station.motion import lie
from station.motion.imu_buffer import ImuBuffer
from station.motion.preintegration import Preintegration, preintegrate

RATE_STEP_S = 0.005  # over which the angular rate at a row is taken


@dataclass(frozen=True, slots=True, eq=False)
class SightingRows:
    """M sightings, two numbers each."""

    residual: FloatArray  # (M, 2)
    by_state: FloatArray  # (M, 2, STATE)
    by_border: FloatArray  # (M, 2, BIASES)
    by_point: FloatArray  # (M, 2, POINT)


@dataclass(frozen=True, slots=True, eq=False)
class InertialRows:
    """What the IMU says between each image and the next: turn, velocity, way."""

    residual: FloatArray  # (K - 1, 9)
    by_states: FloatArray  # (K - 1, 9, 2 * STATE): this image, the next
    by_gravity: FloatArray  # (K - 1, 9, 3)
    by_bias: FloatArray  # (K - 1, 9, 12): the node before, the node after
    node: IntArray  # (K - 1,)


class Inertial:
    """The IMU's readings, to be asked about any time."""

    def __init__(self, imu: ImuBatch, noise: ImuNoise, samples: Samples, origin_ns: int) -> None:
        self.noise = noise
        self._origin_ns = origin_ns
        self._samples = samples
        self._buffer = ImuBuffer(noise)
        self._buffer.add(imu)
        self._angle = np.concatenate(
            [
                np.zeros((1, 3)),
                np.cumsum(0.5 * (samples.gyro[1:] + samples.gyro[:-1]) * np.diff(samples.t_s)[:, None], 0),
            ]
        )

    def angle(self, t_s: FloatArray) -> FloatArray:
        """(N, 3) rad: integral of the readings until then; over hundredths of a second its change is a rotation."""
        t = self._samples.t_s
        return np.stack([np.interp(t_s, t, axis) for axis in self._angle.T], axis=1)

    def rate(self, t_s: FloatArray) -> FloatArray:
        """(N, 3) rad/s, with bias."""
        return (self.angle(t_s + 0.5 * RATE_STEP_S) - self.angle(t_s - 0.5 * RATE_STEP_S)) / RATE_STEP_S

    def force(self, t_s: FloatArray) -> FloatArray:
        """(N, 3) m/s^2, with bias."""
        return np.stack([np.interp(t_s, self._samples.t_s, axis) for axis in self._samples.accel.T], axis=1)

    def between(self, begin_s: float, end_s: float, bias: FloatArray) -> Preintegration:
        """What the readings between two times say, at a bias (6,)."""
        begin, end = (self._origin_ns + round(1e9 * t) for t in (begin_s, end_s))
        return preintegrate(self._buffer.segment(begin, end), bias, self.noise)


def sighting_rows(now: Estimate, seen: Sightings, inertial: Inertial, sigma_px: float) -> SightingRows:
    """Reprojection of each corner from where the body was when its row was exposed."""
    camera, T = now.camera, now.camera.T_body_cam_matrix
    t_body_cam = T[:3, 3]
    k, corner, M = seen.image, seen.corner, len(seen.image)
    middle = 0.5 * (camera.height - 1)
    later = camera.line_delay_s * (seen.uv_px[:, 1] - middle)
    t = now.t_s[k] + later
    bias = now.bias_at(now.t_s)
    rate = inertial.rate(t) - bias[k, :3]
    a = (now.R @ (inertial.force(now.t_s) - bias[:, 3:])[..., None])[..., 0] + now.gravity
    turn = inertial.angle(t) - inertial.angle(now.t_s)[k] - later[:, None] * bias[k, :3]
    after = so3_exp(turn)
    Rt = np.swapaxes(now.R[k] @ after, 1, 2)
    v = now.v[k] + later[:, None] * a[k]
    p = now.p[k] + later[:, None] * (now.v[k] + 0.5 * later[:, None] * a[k])
    rho = now.inverse_depth[corner]
    away = now.anchor[corner] - p
    q = (Rt @ (now.ray[corner] + rho[:, None] * away)[..., None])[..., 0]
    seen_at = Projection.of(camera, (q - rho[:, None] * t_body_cam) @ T[:3, :3], seen.uv_px, sigma_px)
    by_q = seen_at.by_body
    by_p = -rho[:, None, None] * (by_q @ Rt)
    by_state = np.empty((M, 2, STATE))
    by_state[..., :3] = by_q @ skew(q) @ np.swapaxes(after, 1, 2)
    by_state[..., 3:6] = by_p
    by_state[..., 6:] = by_p * later[:, None, None]
    moving = -np.cross(rate, q) - rho[:, None] * (Rt @ v[..., None])[..., 0]
    by_point = np.empty((M, 2, 3))
    by_point[..., :2] = by_q @ Rt @ across(now.ray)[corner]
    by_point[..., 2] = (by_q @ ((Rt @ away[..., None])[..., 0] - t_body_cam)[..., None])[..., 0]
    return SightingRows(seen_at.residual, by_state, seen_at.by_border(moving, rho), by_point)


def inertial_rows(now: Estimate, inertial: Inertial, scale: FloatArray) -> InertialRows:
    """Preintegrated readings between consecutive images; scale (2,): noise of turning and of moving over the known."""
    begin, end = now.t_s[:-1], now.t_s[1:]
    middle = 0.5 * (begin + end)
    bias = now.bias_at(middle)
    node, share = now.bias_weights(middle)
    steps = [inertial.between(*args) for args in zip(begin, end, bias, strict=True)]
    dR, dv, dp = (np.stack([getattr(s, name) for s in steps]) for name in ("dR", "dv", "dp"))
    dt = (end - begin)[:, None]
    Rt = np.swapaxes(now.R[:-1], 1, 2)
    K = len(begin)
    turned = Rt @ now.R[1:]
    r_turn = so3_log(np.swapaxes(dR, 1, 2) @ turned)
    gained = (Rt @ (now.v[1:] - now.v[:-1] - now.gravity * dt)[..., None])[..., 0]
    gone = (Rt @ (now.p[1:] - now.p[:-1] - now.v[:-1] * dt - 0.5 * now.gravity * dt * dt)[..., None])[..., 0]
    residual = np.concatenate([r_turn, gained - dv, gone - dp], axis=1)
    by = np.zeros((K, 9, 2 * STATE))
    right_inverse = lie.so3_left_jacobian_inverse(-r_turn)
    by[:, :3, :3] = -right_inverse @ np.swapaxes(turned, 1, 2)
    by[:, :3, STATE : STATE + 3] = right_inverse
    by[:, 3:6, :3], by[:, 6:, :3] = skew(gained), skew(gone)
    by[:, 3:6, 6:9], by[:, 3:6, STATE + 6 :] = -Rt, Rt
    by[:, 6:, 3:6], by[:, 6:, STATE + 3 : STATE + 6] = -Rt, Rt
    by[:, 6:, 6:9] = -Rt * dt[..., None]
    by_gravity = np.zeros((K, 9, 3))
    by_gravity[:, 3:6], by_gravity[:, 6:] = -Rt * dt[..., None], -0.5 * Rt * (dt * dt)[..., None]
    by_bias = np.zeros((K, 9, 6))
    by_bias[:, :3, :3] = -lie.so3_left_jacobian_inverse(r_turn) @ np.stack([s.dR_by_bias for s in steps])
    by_bias[:, 3:6] = -np.stack([s.dv_by_bias for s in steps])
    by_bias[:, 6:] = -np.stack([s.dp_by_bias for s in steps])
    W = np.stack([s.sqrt_information for s in steps])
    W = W / np.repeat(scale, [3, 6])[:, None]
    nodes = np.concatenate([by_bias * share[:, 0, None, None], by_bias * share[:, 1, None, None]], axis=2)
    return InertialRows((W @ residual[..., None])[..., 0], W @ by, W @ by_gravity, W @ nodes, node)


def carried(now: Estimate, t_s: FloatArray, inertial: Inertial) -> Estimate:
    """The same motion, its states given for other times (K,) nearby, as the IMU says."""
    bias = now.bias_at(now.t_s)
    dt = (t_s - now.t_s)[:, None]
    turn = inertial.angle(t_s) - inertial.angle(now.t_s) - bias[:, :3] * dt
    force = inertial.force(0.5 * (t_s + now.t_s)) - bias[:, 3:]
    a = (now.R @ so3_exp(0.5 * turn) @ force[..., None])[..., 0] + now.gravity
    return replace(now, t_s=t_s, R=now.R @ so3_exp(turn), p=now.p + dt * (now.v + 0.5 * dt * a), v=now.v + dt * a)
