"""A navigation's trajectory against the true poses of the dataset it was made from: what `station evaluate` says."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shared.errors import DataError, DegenerateGeometry
from shared.geometry import IntArray, carry_poses, inverse
from station.datasets import Dataset, Truth
from station.experiments.alignment import AlignmentKind, align_points
from station.experiments.trajectory_error import (
    RelativeError,
    TrajectoryError,
    absolute_trajectory_error,
    relative_pose_error,
)
from station.model.navigation import Navigation, Trajectory
from station.motion.interpolation import MAX_GAP_NS, interpolate_poses

DRIFT_OVER_S = 1.0
MAX_UNKNOWN_NS = 1_000_000_000  # poses further apart than this leave the time between them without one
NEAR_NS = 50_000_000  # a pose at most so far from a frame's time is the frame's, at the ends of a trajectory too


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """How far one navigation is from the truth."""

    kind: AlignmentKind
    absolute: TrajectoryError
    relative: RelativeError | None  # over DRIFT_OVER_S; None where no two compared poses are so far apart
    scale: float | None  # truth over estimate, best fit whatever the alignment; None where all lie on one line
    coverage: float  # 0..1, see `coverage`
    aligned: Trajectory  # the whole estimate in the truth's world
    truth: Truth  # of the same body

    def results(self) -> dict[str, float | int | str | None]:
        """What `station evaluate --json` prints; lengths are the truth's, in metres."""
        return {
            "ate_rmse": self.absolute.rmse_m,
            "rpe_1s_rmse": self.relative.translation_rmse_m if self.relative else None,
            "rot_rmse_deg": math.degrees(self.absolute.rotation_rmse_rad),
            "scale": self.scale,
            "coverage": self.coverage,
            "align": self.kind,
            "poses": len(self.absolute.t_robot_ns),
        }


def evaluate(navigation: Navigation, data: Dataset, kind: AlignmentKind | None = None) -> Evaluation:
    """Compare a navigation with its dataset's truth; `kind` as `usual_alignment` says unless it is given.

    Raises:
        DataError: the dataset has no truth.
        DegenerateGeometry: too few poses in common, or too little motion to align by.
    """
    kind = kind or usual_alignment(navigation)
    truth = truth_of_body(navigation, data)
    trajectory = navigation.trajectory
    absolute = absolute_trajectory_error(trajectory, truth, kind)
    try:
        relative = relative_pose_error(trajectory, truth, DRIFT_OVER_S, absolute.alignment.scale)
    except DegenerateGeometry:
        relative = None
    aligned = carry_poses(absolute.alignment.T_target_source, trajectory.T_world_body)
    return Evaluation(
        kind=kind,
        absolute=absolute,
        relative=relative,
        scale=best_scale(trajectory, truth),
        coverage=coverage(trajectory, data, truth),
        aligned=Trajectory(trajectory.t_robot_ns, aligned),
        truth=truth,
    )


def usual_alignment(navigation: Navigation) -> AlignmentKind:
    """What a navigation leaves open: where it begins, and as far as it does not know them, gravity and scale."""
    if not navigation.is_metric:
        return "sim3"
    return "yaw" if navigation.is_gravity_aligned else "se3"


def truth_of_body(navigation: Navigation, data: Dataset) -> Truth:
    """The true poses of what the navigation calls the body, by its clock.

    The body is the IMU, or the camera where there is no IMU: images of a rig with an IMU may have been used without it.
    Raises DataError where the dataset has no truth.
    """
    truth = data.truth
    if truth is None:
        raise DataError(f"{data.path} holds no true poses; name a dataset that has them")
    ours, theirs = navigation.calibration, data.calibration
    if ours.camera is None or theirs.camera is None or (ours.imu is None) == (theirs.imu is None):
        return truth
    T_theirs_ours = theirs.camera.T_body_cam_matrix @ inverse(ours.camera.T_body_cam_matrix)
    late_ns = round(1e9 * (theirs.camera.time_shift_s - ours.camera.time_shift_s))
    return Truth(truth.t_robot_ns - late_ns, truth.T_world_body @ T_theirs_ours)


def best_scale(trajectory: Trajectory, truth: Truth) -> float | None:
    """The factor that makes the estimate's lengths the truth's: 1 for a metric navigation without error."""
    T_truth, kept = interpolate_poses(truth, trajectory.t_robot_ns)
    try:
        return align_points(T_truth[:, :3, 3], trajectory.T_world_body[kept, :3, 3], "sim3").scale
    except DegenerateGeometry:
        return None


def coverage(trajectory: Trajectory, data: Dataset, truth: Truth) -> float:
    """Share of the dataset's frames with a true pose at whose time the estimate has one too.

    It has one where a pose is near in time, or where poses before and after lie at most MAX_UNKNOWN_NS apart. A dataset
    without frames is asked at the truth's own times.
    """
    camera = data.calibration.camera
    shift_ns = round(1e9 * camera.time_shift_s) if camera is not None else 0
    t = data.frame_times_ns + shift_ns if len(data.frame_times_ns) else truth.t_robot_ns
    t = t[has_pose(truth.t_robot_ns, t, MAX_GAP_NS)]
    return float(has_pose(trajectory.t_robot_ns, t, MAX_UNKNOWN_NS).mean()) if len(t) else 0.0


def has_pose(known_ns: IntArray, t_ns: IntArray, max_gap_ns: int) -> np.typing.NDArray[np.bool_]:
    """(N,) whether a time is near one of the known ones (M, increasing), or between two that are near each other."""
    if not len(known_ns):
        return np.zeros(len(t_ns), dtype=bool)
    after = np.searchsorted(known_ns, t_ns)
    before_ns = known_ns[np.clip(after - 1, 0, len(known_ns) - 1)]
    after_ns = known_ns[np.clip(after, 0, len(known_ns) - 1)]
    is_between = (before_ns <= t_ns) & (t_ns <= after_ns) & (after_ns - before_ns <= max_gap_ns)
    is_near = np.minimum(np.abs(before_ns - t_ns), np.abs(after_ns - t_ns)) <= NEAR_NS
    return np.asarray(is_between | is_near)
