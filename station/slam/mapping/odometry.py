"""Relative motions between keyframes with their uncertainty, as bundle adjustment weighs them: odometry.

Of dead reckoning (station/motion/dead_reckoning.py) here; the filter's are made in ukf/map/view_map.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, diags

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, rotation_angle, skew, so3_log
from station.model.frames import DriveSample, ImuBatch
from station.motion.dead_reckoning import reckon_drive
from station.motion.inertial_track import InertialTrack
from station.slam.mapping.odometry_bundle import HELD_SIGMA, BundleState
from station.vision.lens import BoolArray

SLIP = 0.15  # of the way between keyframes, one sigma: skid-steer wheels on carpets
SLIP_PER_RADIAN_M = 0.03  # a skid-steer body turns about a point that wanders by centimetres
GAP_SIGMA_RAD = 0.2  # while inertial samples are missing the body may turn unseen
POSITION_FLOOR_M = 0.004
VERTICAL_SIGMA_M = 0.003  # floors are flat; carpets and thresholds are not quite
# Scale is a free gauge of the pictures, and noise would shrink it: held here, found by the inertial terms or metric.py.
DRIVE_SCALE_SIGMA = 0.002
GYRO_BIAS_SIGMA = 2e-3  # rad/s, around the bias the odometry was made with
SLIP_CAUCHY = 3.0  # sigmas: wheels that spin against a chair are outliers, not noise
MOTION_START = np.array([1.0, 0.0, 0.0, 0.0])  # BundleState.motion: real way per way said, change of gyroscope bias


@dataclass(frozen=True, slots=True)
class Drift:
    """How wrong a chain of relative motions may be: a loop that says more shows a look-alike, not the same thing."""

    position_m: float
    position_per_way: float
    rotation_rad: float

    def explains(self, moved_m: float, turned_rad: float, way_m: float) -> bool:
        """Whether a loop over such a way may correct by so much."""
        return turned_rad < self.rotation_rad and moved_m < self.position_m + self.position_per_way * way_m


DEAD_RECKONED = Drift(position_m=0.3, position_per_way=0.05, rotation_rad=0.09)


@dataclass(frozen=True, slots=True, eq=False)
class RelativeMotions:
    """Relative motion between consecutive keyframes, in the body frame of the first of the two."""

    T_world_body: FloatArray  # (N, 4, 4) the same chained, z up
    R: FloatArray  # (N-1, 3, 3) R_k_next
    R_sum: FloatArray  # (N-1, 3, 3) s: rotation changes by -R^T R_sum @ gyroscope bias change
    p: FloatArray  # (N-1, 3) m
    sigma_rotation: FloatArray  # (N-1,) rad
    sigma_position: FloatArray  # (N-1, 3) m, body axes
    drift: Drift  # of the whole chain
    slips: BoolArray  # (N-1,) those that may be off by many sigmas: their positions count by Cauchy's loss

    def cost(self, state: BundleState) -> float:
        weighted, _, _ = self._residuals(state)
        turn = float((weighted[:, :3] ** 2).sum())
        squared = (weighted[:, 3:] ** 2).sum(axis=1)
        slip = float(np.where(self.slips, SLIP_CAUCHY**2 * np.log1p(squared / SLIP_CAUCHY**2), squared).sum())
        prior = (state.motion - MOTION_START) / _PRIOR_SIGMA
        return turn + slip + float(prior @ prior)

    def normal_equations(self, state: BundleState) -> tuple[csc_matrix, FloatArray]:
        """See MotionTerms."""
        n, k = len(state.R_world_body), len(self.p)
        size = 6 * n + len(MOTION_START)
        weighted, R_rel, p_rel = self._residuals(state)
        J = np.zeros((k, 6, 16))
        R_a_t = np.swapaxes(state.R_world_body[:-1], 1, 2)
        J[:, :3, 0:3] = -np.swapaxes(R_rel, 1, 2)
        J[:, :3, 6:9] = np.eye(3)
        J[:, 3:, 0:3] = skew(p_rel)
        J[:, 3:, 3:6] = -R_a_t
        J[:, 3:, 9:12] = R_a_t
        J[:, 3:, 12] = -self.p
        J[:, :3, 13:16] = np.swapaxes(self.R, 1, 2) @ self.R_sum
        J[:, :3] /= self.sigma_rotation[:, None, None]
        J[:, 3:] /= self.sigma_position[:, :, None]
        cauchy = 1.0 / np.sqrt(1.0 + (weighted[:, 3:] ** 2).sum(axis=1) / SLIP_CAUCHY**2)
        robust = np.where(self.slips, cauchy, 1.0)
        J[:, 3:] *= robust[:, None, None]
        weighted = weighted.copy()
        weighted[:, 3:] *= robust[:, None]
        columns = np.hstack([
            6 * np.arange(k)[:, None] + np.arange(12), np.broadcast_to(np.arange(6 * n, size), (k, len(MOTION_START)))
        ])  # fmt: skip
        jacobian = sparse_rows(J, columns, size)
        prior = np.concatenate([np.full(6, HELD_SIGMA**-2), np.zeros(6 * n - 6), _PRIOR_SIGMA**-2])
        g = jacobian.T @ weighted.ravel()
        g[6 * n :] += (state.motion - MOTION_START) * _PRIOR_SIGMA**-2
        return (jacobian.T @ jacobian + diags(prior)).tocsc(), g

    def _residuals(self, state: BundleState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N-1, 6) weighted residuals; relative rotations and translations as estimated."""
        R_a, R_b = state.R_world_body[:-1], state.R_world_body[1:]
        R_rel = np.swapaxes(R_a, 1, 2) @ R_b
        p_rel = np.einsum("nji,nj->ni", R_a, np.diff(state.p_world_body, axis=0))
        error = np.swapaxes(self.R, 1, 2) @ R_rel
        J_bias = np.swapaxes(self.R, 1, 2) @ self.R_sum
        turn = so3_log(error) + J_bias @ state.motion[1:]
        slip = p_rel - state.motion[0] * self.p
        return np.hstack([turn / self.sigma_rotation[:, None], slip / self.sigma_position]), R_rel, p_rel


_PRIOR_SIGMA = np.array([DRIVE_SCALE_SIGMA, GYRO_BIAS_SIGMA, GYRO_BIAS_SIGMA, GYRO_BIAS_SIGMA])


def sparse_rows(J: FloatArray, columns: IntArray, size: int) -> csc_matrix:
    """Blocks J (k, r, c), of which each has its own columns (k, c), as one matrix (k r, size)."""
    k, r, c = J.shape
    rows = np.repeat(np.arange(k * r), c)
    return csc_matrix((J.ravel(), (rows, np.repeat(columns, r, axis=0).ravel())), shape=(k * r, size))


@dataclass(frozen=True, slots=True, eq=False)
class Odometry(RelativeMotions):
    """Dead reckoned: turned by the gyroscope, moved by drive commands, first keyframe at the origin."""

    track: InertialTrack


def dead_reckon(
    imu: ImuBatch, drive: list[DriveSample], t_ns: IntArray, noise: ImuNoise, gyro_bias: FloatArray | None = None
) -> Odometry:
    """Where gyroscope and drive commands say the body was at the keyframes.

    Args:
        t_ns: (N,) keyframe times on the IMU's clock, within its samples.
        gyro_bias: (3,) rad/s; None: from the time at rest, else zero.
    """
    T_world_body, track = reckon_drive(imu, drive, t_ns, gyro_bias)
    R_world, p_world = T_world_body[:, :3, :3], T_world_body[:, :3, 3]
    step = track.increments(t_ns)
    p = np.einsum("nji,nj->ni", R_world[:-1], np.diff(p_world, axis=0))
    length = np.linalg.norm(p, axis=1)
    turn = rotation_angle(step.R)
    along = np.sqrt(POSITION_FLOOR_M**2 + (SLIP * length) ** 2 + (SLIP_PER_RADIAN_M * turn) ** 2)
    sigma_position = np.column_stack([along, along, np.hypot(VERTICAL_SIGMA_M, 0.01 * length)])
    sigma_rotation = np.sqrt(noise.gyro_density**2 * step.dt + (0.003 * turn) ** 2 + 2e-4**2)
    for k in range(len(t_ns) - 1):
        if track.has_gap(int(t_ns[k]), int(t_ns[k + 1])):
            sigma_rotation[k] = GAP_SIGMA_RAD
    return Odometry(
        T_world_body=T_world_body,
        R=step.R,
        R_sum=step.R_sum,
        p=p,
        sigma_rotation=sigma_rotation,
        sigma_position=sigma_position,
        drift=DEAD_RECKONED,
        slips=np.ones(len(length), dtype=bool),
        track=track,
    )
