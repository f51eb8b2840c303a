"""How far an estimated trajectory is from the truth: ATE and RPE. Judges only.

Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012; Zhang and Scaramuzza, A tutorial
on quantitative trajectory evaluation for visual(-inertial) odometry, IROS 2018 (which alignment for which sensors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.errors import DegenerateGeometry
from shared.geometry import FloatArray, IntArray, inverse, so3_log, transform
from station.experiments.alignment import Alignment, AlignmentKind, align_points
from station.motion.interpolation import Poses, interpolate_poses

STAMP_ROUNDING_NS = 1_000_000  # times of a constant rate, rounded: 30 frames at 30 Hz may be 10 ns short of a second


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryError:
    """Absolute trajectory error after alignment of the estimate to the truth."""

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float
    rotation_rmse_rad: float
    alignment: Alignment  # T_truth_estimate
    offsets_m: FloatArray  # (M, 3) aligned estimate minus truth, truth's axes, one per compared pose
    turns_rad: FloatArray  # (M, 3) rotation vectors from the truth to the aligned estimate, truth's axes
    t_robot_ns: IntArray  # (M,) the compared times


@dataclass(frozen=True, slots=True, eq=False)
class RelativeError:
    """Relative pose error over a fixed time: drift, whatever the rigid alignment."""

    delta_s: float
    translation_rmse_m: float
    rotation_rmse_rad: float
    num_pairs: int


def absolute_trajectory_error(estimate: Poses, truth: Poses, kind: AlignmentKind = "yaw") -> TrajectoryError:
    """Compare positions after alignment of the estimate: "yaw" for metric gravity-aligned, "sim3" for scale-free SLAM.

    Truth is interpolated at the estimate's times.
    Raises:
        DegenerateGeometry: fewer than three common times, or no motion to align by.
    """
    T_truth, kept = interpolate_poses(truth, estimate.t_robot_ns)
    if len(kept) < 3:
        raise DegenerateGeometry(f"estimate and truth share {len(kept)} times, at least 3 are needed")
    T_est = estimate.T_world_body[kept]
    alignment = align_points(T_truth[:, :3, 3], T_est[:, :3, 3], kind)
    offsets = transform(alignment.T_target_source, T_est[:, :3, 3]) - T_truth[:, :3, 3]
    turns = so3_log(alignment.R_target_source @ T_est[:, :3, :3] @ np.swapaxes(T_truth[:, :3, :3], 1, 2))
    errors = np.linalg.norm(offsets, axis=1)
    return TrajectoryError(
        rmse_m=_rms(errors),
        mean_m=float(errors.mean()),
        median_m=float(np.median(errors)),
        max_m=float(errors.max()),
        rotation_rmse_rad=_rms(np.linalg.norm(turns, axis=1)),
        alignment=alignment,
        offsets_m=offsets,
        turns_rad=turns,
        t_robot_ns=np.asarray(estimate.t_robot_ns)[kept],
    )


def relative_pose_error(estimate: Poses, truth: Poses, delta_s: float, scale: float = 1.0) -> RelativeError:
    """Compare motions over delta_s. Pairs: each estimated pose and the first one at least delta_s later.

    At a constant rate these are evo's pairs of so many frames, all of them (`all_pairs`).

    Args:
        scale: factor on the estimate's translations, for navigations of arbitrary scale.
    Raises:
        DegenerateGeometry: no pair that far apart in time (within half of delta_s).
    """
    T_truth, kept = interpolate_poses(truth, estimate.t_robot_ns)
    t = np.asarray(estimate.t_robot_ns)[kept]
    T_est = estimate.T_world_body[kept].copy()
    T_est[:, :3, 3] *= scale
    delta_ns = round(delta_s * 1e9)
    end = np.searchsorted(t, t + delta_ns - STAMP_ROUNDING_NS)
    begin = np.flatnonzero(end < len(t))
    begin = begin[t[end[begin]] - t[begin] <= 1.5 * delta_ns]
    if not len(begin):
        raise DegenerateGeometry(f"no two compared poses lie {delta_s} s apart")
    end = end[begin]
    motion_truth = inverse(T_truth[begin]) @ T_truth[end]
    motion_est = inverse(T_est[begin]) @ T_est[end]
    error = inverse(motion_truth) @ motion_est  # Sturm et al., eq. 1
    return RelativeError(
        delta_s=delta_s,
        translation_rmse_m=_rms(np.linalg.norm(error[:, :3, 3], axis=1)),
        rotation_rmse_rad=_rms(np.linalg.norm(so3_log(error[:, :3, :3]), axis=1)),
        num_pairs=len(begin),
    )


def path_length(poses: Poses) -> float:
    """Length (m) of the line through all positions."""
    return float(np.linalg.norm(np.diff(poses.T_world_body[:, :3, 3], axis=0), axis=1).sum())


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
