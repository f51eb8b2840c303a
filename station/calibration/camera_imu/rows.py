"""What was measured against what the unknowns predict: whitened residuals and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shared.calibration import ImuNoise
from shared.geometry import FloatArray, IntArray, skew
from station.calibration.camera_imu.projection import Projection
from station.calibration.camera_imu.spline import ORDER, Orientation
from station.calibration.camera_imu.unknowns import (
    BEND,
    BIASES,
    GRAVITY,
    SCALE,
    Unknowns,
)
from station.calibration.target import BoardView, Target
from station.model.frames import ImuBatch
from station.vision.lens import BoolArray

SIGMA_UNSEEN_GYRO, SIGMA_UNSEEN_ACCEL = 2.0, 20.0  # rad/s, m/s^2: what a hand changes within a tenth of a second
KNOT = 6  # unknowns of one: rotation, position


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Inertial readings, and how noisy each of them is."""

    t_s: FloatArray  # (N,) IMU clock
    gyro: FloatArray  # (N, 3) rad/s
    accel: FloatArray  # (N, 3) m/s^2
    sigma_gyro: float
    sigma_accel: float

    @classmethod
    def of(cls, imu: ImuBatch, noise: ImuNoise, origin_ns: int) -> Samples:
        """With the standard deviation of one sample that such noise means; accelerations are forces, as in a buffer."""
        t_s = np.asarray(1e-9 * (imu.t_robot_ns - origin_ns), dtype=np.float64)
        per_sample = 1.0 / np.sqrt(np.median(np.diff(t_s)))
        sigmas = noise.gyro_density * per_sample, noise.accel_density * per_sample
        return cls(t_s, imu.gyro_imu, noise.forces(imu.accel_imu), *sigmas)

    @property
    def interval_s(self) -> float:
        return float(np.median(np.diff(self.t_s)))

    def interpolated(self, t_s: FloatArray) -> Samples:
        """What it would have read at other times (N,), as surely as a hand's motion is foretold from its past."""
        gyro, accel = (
            np.stack([np.interp(t_s, self.t_s, axis) for axis in read.T], axis=1) for read in (self.gyro, self.accel)
        )
        return Samples(t_s, gyro, accel, SIGMA_UNSEEN_GYRO, SIGMA_UNSEEN_ACCEL)

    def between(self, begin_s: float, end_s: float) -> Samples:
        inside = (self.t_s >= begin_s) & (self.t_s <= end_s)
        return replace(self, t_s=self.t_s[inside], gyro=self.gyro[inside], accel=self.accel[inside])


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The corners of all views, one after the other."""

    ids: IntArray  # (M,) rows of Target.corners
    t_s: FloatArray  # (M,) camera clock, of the image's first row
    uv_px: FloatArray  # (M, 2)
    board: FloatArray  # (M, 3) m, where it is on the target
    bend: FloatArray  # (M, 3) by how much each of Unknowns.bend moves it along z
    sigma_px: float

    @classmethod
    def of(cls, views: list[BoardView], target: Target, origin_ns: int, sigma_px: float) -> Corners:
        counts = [len(view.ids) for view in views]
        corners = target.corners
        ids = np.concatenate([view.ids for view in views])
        board = corners[ids]
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        half = 0.5 * np.ptp(corners, axis=0)[:2]
        x, y = ((board - middle)[:, :2] / half).T
        times = np.array([1e-9 * (view.t_robot_ns - origin_ns) for view in views])
        return cls(
            ids=ids,
            t_s=np.repeat(times, counts),
            uv_px=np.concatenate([view.corners_px for view in views]),
            board=board,
            bend=np.stack([x * x, x * y, y * y], axis=1),
            sigma_px=sigma_px,
        )

    def chosen(self, which: BoolArray | IntArray) -> Corners:
        """Those of which `which` (M,) is true, or whose rows it names."""
        return Corners(
            self.ids[which], self.t_s[which], self.uv_px[which], self.board[which], self.bend[which], self.sigma_px
        )


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """N measurements of m whitened numbers each; predicted minus measured."""

    segment: IntArray  # (N,) of the motion
    residual: FloatArray  # (N, m)
    by_knots: FloatArray  # (N, m, KNOT * ORDER)
    by_border: FloatArray  # (N, m, c)
    columns: IntArray  # (c,) of the border

    def weighted(self, weight: FloatArray) -> Rows:
        """Each measurement times the square root of its weight (N,)."""
        root = np.sqrt(weight)
        return Rows(
            self.segment,
            self.residual * root[:, None],
            self.by_knots * root[:, None, None],
            self.by_border * root[:, None, None],
            self.columns,
        )


def joined(parts: Sequence[Rows]) -> Rows:
    """Measurements of the same columns, one after the other."""
    segment, residual, by_knots, by_border = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("segment", "residual", "by_knots", "by_border")
    )
    return Rows(segment, residual, by_knots, by_border, parts[0].columns)


def inertial_rows(unknowns: Unknowns, samples: Samples) -> Rows:
    """Gyroscope and accelerometer: omega + bias, R^T (a - g) + bias."""
    weights = unknowns.motion.weights(samples.t_s)
    turned = unknowns.motion.orientations(weights)
    _, _, a = unknowns.motion.positions(weights)
    Rt = np.swapaxes(turned.R, 1, 2)
    force = (Rt @ (a - unknowns.gravity)[..., None])[..., 0]
    node, share = unknowns.bias_weights(samples.t_s)
    bias = share[:, :1] * unknowns.biases[node] + share[:, 1:] * unknowns.biases[node + 1]
    N = len(samples.t_s)
    residual = np.concatenate([turned.omega, force], axis=1) + bias
    residual -= np.concatenate([samples.gyro, samples.accel], axis=1)
    by_knots = np.zeros((N, 6, ORDER, KNOT))
    by_R, by_omega = np.zeros((2, N, 6, 3))
    by_R[:, 3:] = skew(force)
    by_omega[:, [0, 1, 2], [0, 1, 2]] = 1.0
    by_knots[..., :3] = turned.by_knots(by_R, by_omega)
    by_knots[:, 3:, :, 3:] = Rt[:, :, None, :] * weights.blend[:, None, 2, :, None]
    by_border = np.zeros((N, 6, 3 + unknowns.biases.size))
    by_border[:, 3:, :3] = -Rt
    axis = np.arange(6)
    for side in (0, 1):
        at = 3 + 6 * (node + side)[:, None] + axis
        by_border[np.arange(N)[:, None], axis, at] = share[:, side, None]
    columns = np.concatenate([np.arange(GRAVITY.start, GRAVITY.stop), BIASES + np.arange(unknowns.biases.size)])
    sigma = np.repeat([samples.sigma_gyro, samples.sigma_accel], 3)
    return Rows(
        weights.segment,
        residual / sigma,
        by_knots.reshape(N, 6, ORDER * KNOT) / sigma[:, None],
        by_border / sigma[:, None],
        columns,
    )


def row_times(unknowns: Unknowns, corners: Corners) -> FloatArray:
    """(M,) s, IMU clock: when the image row that saw each corner was exposed."""
    camera = unknowns.camera
    return np.asarray(corners.t_s + camera.time_shift_s + camera.line_delay_s * corners.uv_px[:, 1])


def camera_rows(unknowns: Unknowns, corners: Corners) -> Rows:
    """Reprojection of each corner from where the body was when its row was exposed."""
    T_body_cam = unknowns.camera.T_body_cam_matrix
    weights = unknowns.motion.weights(row_times(unknowns, corners))
    turned = unknowns.motion.orientations(weights)
    p, v, _ = unknowns.motion.positions(weights)
    Rt = np.swapaxes(turned.R, 1, 2)
    board = unknowns.scale * corners.board
    board[:, 2] += corners.bend @ unknowns.bend
    p_body = (Rt @ (board - p)[..., None])[..., 0]
    p_cam = (p_body - T_body_cam[:3, 3]) @ T_body_cam[:3, :3]
    seen = Projection.of(unknowns.camera, p_cam, corners.uv_px, corners.sigma_px)
    by_board = seen.by_body @ Rt
    M = len(p_cam)
    by_knots = np.empty((M, 2, ORDER, KNOT))
    by_knots[..., :3] = turned.by_knots(seen.by_body @ skew(p_body))
    by_knots[..., 3:] = -by_board[:, :, None, :] * weights.blend[:, None, 0, :, None]
    by_border = seen.by_border(_seen_moving(turned, p_body, v), np.ones(M))
    by_border[..., SCALE] = (by_board @ corners.board[..., None])[..., 0]
    by_border[..., BEND] = by_board[:, :, 2, None] * corners.bend[:, None]
    return Rows(weights.segment, seen.residual, by_knots.reshape(M, 2, -1), by_border, np.arange(BIASES))


def _seen_moving(turned: Orientation, p_body: FloatArray, v: FloatArray) -> FloatArray:
    """(M, 3) m/s: how the corners move in the body's frame."""
    Rt = np.swapaxes(turned.R, 1, 2)
    return np.asarray(-np.cross(turned.omega, p_body) - (Rt @ v[..., None])[..., 0])
