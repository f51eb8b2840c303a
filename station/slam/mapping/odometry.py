"""Dead reckoning from gyroscope and drive commands: good to a few per cent of the way, whatever the camera sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, rotation_angle, se3, upright
from station.model.frames import DriveSample, ImuBatch
from station.slam.mapping.inertial import InertialTrack

MOTOR_TIME_CONSTANT_S = 0.15  # wheels follow their command like a first-order lag
REST_AFTER_S = 0.7  # commands must have been zero this long for the body to stand still
MIN_REST_S = 0.5
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


def resting_samples(imu: ImuBatch, drive: list[DriveSample]) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(N,) inertial samples during which the motors had been told to stand still for a while."""
    moving_until = np.full(len(imu), -np.inf)
    t = imu.t_robot_ns * 1e-9
    for k, d in enumerate(drive):
        if d.linear_m_s == 0.0 and d.angular_rad_s == 0.0:
            continue
        begin = d.t_robot_ns * 1e-9
        end = drive[k + 1].t_robot_ns * 1e-9 if k + 1 < len(drive) else np.inf  # a command holds until the next one
        moving_until[(t >= begin) & (t < end + REST_AFTER_S)] = np.inf
    return moving_until < 0


def bias_at_rest(imu: ImuBatch, drive: list[DriveSample]) -> FloatArray | None:
    """Gyroscope bias (3,) rad/s from the time the robot stood still; None where that is too short."""
    rest = resting_samples(imu, drive)
    if rest.sum() < 2:
        return None
    period = float(np.median(np.diff(imu.t_robot_ns))) * 1e-9
    if rest.sum() * period < MIN_REST_S:
        return None
    return np.asarray(np.median(imu.gyro_imu[rest], axis=0))


def level(imu: ImuBatch, track: InertialTrack, drive: list[DriveSample]) -> FloatArray:
    """R_world_start (3, 3): z up at the first sample, x axis of the body at yaw 0."""
    rest = resting_samples(imu, drive)
    use = rest if rest.sum() > 50 else np.ones(len(imu), dtype=bool)  # a whole drive's mean: accelerations cancel
    up = np.einsum("nij,nj->i", track.R[use], imu.accel_imu[use])
    return upright(up, np.eye(3))


def wheel_speed(drive: list[DriveSample], t_ns: IntArray) -> FloatArray:
    """Forward speed (M,) m/s at increasing times: the commands through the motors' lag."""
    begin = np.array([d.t_robot_ns for d in drive], dtype=np.int64)
    k = np.searchsorted(begin, t_ns, side="right") - 1
    told = np.where(k >= 0, np.array([d.linear_m_s for d in drive])[np.maximum(k, 0)], 0.0)
    out = np.empty(len(t_ns))
    speed = 0.0
    keep = np.exp(-np.diff(t_ns, prepend=t_ns[0]) * 1e-9 / MOTOR_TIME_CONSTANT_S)
    for i, (target, factor) in enumerate(zip(told.tolist(), keep.tolist(), strict=True)):
        speed = target + (speed - target) * factor
        out[i] = speed
    return out


def dead_reckon(
    imu: ImuBatch, drive: list[DriveSample], t_ns: IntArray, noise: ImuNoise, gyro_bias: FloatArray | None = None
) -> Odometry:
    """Where gyroscope and drive commands say the body was at the keyframes.

    Args:
        t_ns: (N,) keyframe times on the IMU's clock, within its samples.
        gyro_bias: (3,) rad/s; None: from the time at rest, else zero.
    """
    if gyro_bias is None:
        gyro_bias = bias_at_rest(imu, drive)
    track = InertialTrack(imu, np.zeros(3) if gyro_bias is None else gyro_bias)
    R_world_start = level(imu, track, drive)
    speed = wheel_speed(drive, imu.t_robot_ns)
    velocity = (R_world_start @ track.R)[:, :, 0] * speed[:, None]
    dt = np.diff(imu.t_robot_ns)[:, None] * 1e-9
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt, axis=0)])
    seconds = (imu.t_robot_ns - imu.t_robot_ns[0]) * 1e-9
    at = (t_ns - imu.t_robot_ns[0]) * 1e-9
    p_world = np.column_stack([np.interp(at, seconds, way[:, i]) for i in range(3)])
    p_world -= p_world[0]
    R_world = R_world_start @ track.rotation_at(t_ns)
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
        T_world_body=np.stack([se3(R, t) for R, t in zip(R_world, p_world, strict=True)]),
        R=step.R,
        R_sum=step.R_sum,
        p=p,
        sigma_rotation=sigma_rotation,
        sigma_position=sigma_position,
        drift=DEAD_RECKONED,
        track=track,
    )
