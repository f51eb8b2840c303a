"""Relative motions between keyframes with their uncertainty, as bundle adjustment weighs them: odometry.

Of dead reckoning (station/motion/dead_reckoning.py) here; the filter's are made in ukf/map/view_map.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, rotation_angle
from station.model.frames import DriveSample, ImuBatch
from station.motion.dead_reckoning import reckon_drive
from station.motion.inertial_track import InertialTrack

SLIP = 0.15  # of the way between keyframes, one sigma: skid-steer wheels on carpets
SLIP_PER_RADIAN_M = 0.03  # a skid-steer body turns about a point that wanders by centimetres
GAP_SIGMA_RAD = 0.2  # while inertial samples are missing the body may turn unseen
POSITION_FLOOR_M = 0.004
VERTICAL_SIGMA_M = 0.003  # floors are flat; carpets and thresholds are not quite


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
        track=track,
    )
